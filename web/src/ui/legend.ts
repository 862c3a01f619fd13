/** What the colours mean, for colour modes that the panel does not explain. */

import type { ColorMode } from "../scene/material";
import { IMPORTANCE_STOPS, LEVEL_COLORS } from "../transfer/lut";
import { h, setText } from "./dom";
import { formatCount } from "./format";

export class Legend {
  private readonly counts = LEVEL_COLORS.map(() => h("span", { class: "count" }));
  private readonly levels = h(
    "div",
    { class: "level-legend" },
    ...LEVEL_COLORS.flatMap((css, level) => [
      h("i", { class: "swatch", style: `background:${css}` }),
      h("span", {}, `Level ${level}`),
      this.counts[level],
    ]),
  );
  private readonly ramp = h(
    "div",
    { class: "ramp-legend" },
    h("span", {}, "unimportant"),
    h("i", { style: `background:linear-gradient(to right, ${IMPORTANCE_STOPS.join(", ")})` }),
    h("span", {}, "important"),
  );
  readonly element = h("div", { class: "display-legend", hidden: true }, this.levels, this.ramp);

  setLevelTriangles(counts: readonly number[]): void {
    this.counts.forEach((element, level) => setText(element, formatCount(counts[level] ?? 0)));
  }

  show(mode: ColorMode): void {
    this.element.hidden = mode === "transfer";
    this.levels.hidden = mode !== "level";
    this.ramp.hidden = mode !== "importance";
  }
}
