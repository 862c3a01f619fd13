/** What stands in the middle of the picture while there is no surface, or while another volume is being read. */

import type { ViewerState } from "../state/viewer";
import { h, setText } from "./dom";
import { formatBytes, formatValue } from "./format";

export class Hint {
  readonly element: HTMLElement;
  private readonly text = h("span");
  private readonly bar = h("progress", { max: 1, "aria-label": "Read of the volume" });
  private readonly amount = h("span", { class: "amount" });

  constructor() {
    this.element = h("div", { class: "hint", role: "status" }, this.text, this.bar, this.amount);
  }

  /** `triangles` are on screen; `busy`: they are not what the values in force ask for. */
  update(state: ViewerState, triangles: number, busy: boolean): void {
    const { readProgress, target, volume } = state;
    // Another step of the volume mostly comes at once: the surface of the one before stays in sight.
    const reading = readProgress !== undefined && target?.volume !== volume?.id;
    const text = triangles === 0 || reading ? hintText(state, busy) : "";
    this.element.hidden = text === "";
    setText(this.text, text);
    this.bar.hidden = readProgress === undefined;
    this.amount.hidden = readProgress === undefined;
    if (readProgress === undefined) return;
    const { bytes, totalBytes } = readProgress;
    this.bar.value = totalBytes > 0 ? bytes / totalBytes : 1;
    setText(this.amount, `${formatBytes(bytes)} of ${formatBytes(totalBytes)} read`);
  }
}

/** Why there is no surface. */
function hintText(state: ViewerState, busy: boolean): string {
  const { volumes, target, view } = state;
  if (volumes?.length === 0) return "This server has no volumes";
  if (state.opening) return `Opening ${volumes?.find((v) => v.id === target?.volume)?.title ?? target?.volume ?? ""}`;
  if (state.connection !== "connected") return state.volume === undefined ? "Connecting to the server" : "";
  if (busy) return "Extracting the surface";
  if (state.shown?.final === true && view !== undefined) {
    return `No surface at isovalue ${formatValue(view.iso)}: no sample on one side of it`;
  }
  return "";
}
