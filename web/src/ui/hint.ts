/** What stands in the middle of the picture while there is no surface, or while another volume is being opened. */

import type { ViewerState } from "../state/viewer";
import { h, setText } from "./dom";
import { formatPercent, formatValue } from "./format";

export class Hint {
  readonly element: HTMLElement;
  private readonly text = h("span");
  private readonly bar = h("progress", { max: 1, "aria-label": "Progress" });
  private readonly amount = h("span", { class: "amount" });

  constructor() {
    this.element = h("div", { class: "hint", role: "status" }, this.text, this.bar, this.amount);
  }

  /** `triangles` are on screen; `busy`: they are not what the values in force ask for. */
  update(state: ViewerState, triangles: number, busy: boolean): void {
    const { openedShare, target, volume } = state;
    // Another step of the volume mostly comes at once: the surface of the one before stays in sight.
    const isAnother = openedShare !== undefined && target?.volume !== volume?.id;
    const text = triangles === 0 || isAnother ? hintText(state, busy) : "";
    this.element.hidden = text === "";
    setText(this.text, text);
    this.bar.hidden = openedShare === undefined;
    this.amount.hidden = openedShare === undefined;
    if (openedShare === undefined) return;
    this.bar.value = openedShare;
    setText(this.amount, formatPercent(openedShare));
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
