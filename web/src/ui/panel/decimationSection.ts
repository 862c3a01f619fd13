/** How much is decimated: by β or by a budget, and within which guards. */

import { LEVELS } from "../../protocol/generated";
import type { Edit, Statistics, View } from "../../protocol/types";
import { Segmented, Select, Slider, type Scale } from "../controls";
import { h } from "../dom";
import { formatValue } from "../format";
import { row, section } from "./section";

/** β on the slider: the low end is the full surface, the rest four decades up to 1. */
export const BETA_SCALE: Scale = {
  toValue: (t) => (t <= 0 ? -1 : Number((10 ** (4 * (t - 1))).toPrecision(3))),
  toPosition: (beta) => (beta < 0 ? 0 : Math.min(1, Math.max(0.001, 1 + Math.log10(Math.max(beta, 1e-9)) / 4))),
};

/** Low end of the slider of triangles. */
const MIN_TRIANGLES = 1000;

export class DecimationSection {
  readonly element: HTMLElement;
  private readonly quality: Segmented<"beta" | "triangles">;
  private readonly betaSlider: Slider;
  private readonly triangles: Slider;
  private readonly guards: AdvancedControls;
  private view: View | undefined;
  /** Of the last final surface. */
  private statistics: Statistics | undefined;

  constructor(onEdit: (edit: Edit) => void) {
    this.quality = new Segmented(
      "Decide by",
      [
        { value: "beta", text: "β", hint: "Decimate what is less important than β" },
        { value: "triangles", text: "Triangles", hint: "Find the β that gives at most so many triangles" },
      ],
      (by) => {
        if (by === "beta") onEdit({ beta: Number((this.statistics?.beta ?? 0.02).toPrecision(3)) });
        else onEdit({ triangles: twoDigits(this.statistics?.triangles ?? 100_000) });
      },
    );
    this.betaSlider = new Slider("β", "Importance up to which a part is decimated; at the low end nothing is", {
      scale: BETA_SCALE,
      min: -1,
      max: 1,
      step: () => Math.max(1e-4, Number(((this.view?.beta ?? 0.01) / 10).toPrecision(1))),
      describe: (beta) => (beta < 0 ? "full surface" : "decimate up to"),
      onChange: (beta) => onEdit({ beta }),
    });
    this.triangles = new Slider("Triangles", "The most triangles the surface may have", {
      scale: {
        toValue: (t) => twoDigits(MIN_TRIANGLES * (this.maxTriangles / MIN_TRIANGLES) ** t),
        toPosition: (n) => Math.min(1, Math.max(0, Math.log(n / MIN_TRIANGLES) / Math.log(this.maxTriangles / MIN_TRIANGLES))),
      },
      min: 1,
      max: Infinity,
      step: () => twoDigits((this.view?.triangles ?? MIN_TRIANGLES) / 10),
      describe: () => (this.statistics === undefined ? "at most" : `at most, β ${formatValue(this.statistics.beta, 3)}`),
      onChange: (triangles) => onEdit({ triangles: Math.round(triangles) }),
    });
    this.guards = new AdvancedControls(onEdit);
    this.element = section(
      "Decimation",
      row("Decide by", "What decides how much is decimated", this.quality.element),
      this.betaSlider.element,
      this.triangles.element,
      this.guards.element,
    );
  }

  /** β in force: the view's, or the one that was found for a budget. */
  get beta(): number | undefined {
    return this.view?.beta ?? this.statistics?.beta;
  }

  setView(view: View): void {
    this.view = view;
    this.guards.set(view);
    this.showQuality();
  }

  setStatistics(statistics: Statistics | undefined): void {
    this.statistics = statistics;
    this.showQuality();
  }

  private showQuality(): void {
    const { view, beta } = this;
    if (view === undefined) return;
    const budget = view.triangles !== undefined;
    this.quality.set(budget ? "triangles" : "beta");
    this.betaSlider.element.hidden = budget;
    this.triangles.element.hidden = !budget;
    if (beta !== undefined) this.betaSlider.set(beta);
    if (view.triangles !== undefined) this.triangles.set(view.triangles);
  }

  /** High end of the slider of triangles: the full surface. */
  private get maxTriangles(): number {
    return Math.max(10 * MIN_TRIANGLES, this.statistics?.fullTriangles ?? 1_000_000);
  }
}

/** Limits on the error that are offered; another one that is in force is added. */
const ERROR_LIMITS = ["none", "0.1vx", "0.25vx", "0.5vx", "1vx"];

/** Guards, mesher and what else is changed rarely. */
class AdvancedControls {
  readonly element: HTMLElement;
  private readonly maxLevel: Segmented<number>;
  private readonly mesher: Segmented<View["mesher"]>;
  private readonly topology: Segmented<View["topology"]>;
  private readonly maxError: Select;
  private readonly polish: Segmented<"off" | "on">;

  constructor(onEdit: (edit: Edit) => void) {
    this.maxLevel = new Segmented(
      "Coarsest level",
      Array.from({ length: LEVELS }, (_, level) => ({
        value: level,
        text: String(level),
        hint: level === 0 ? "No cube is merged" : `Cubes of up to ${2 ** level} cells per axis`,
      })),
      (maxLevel) => onEdit({ maxLevel }),
    );
    this.mesher = new Segmented(
      "Mesher",
      [
        { value: "dual", text: "Dual", hint: "Watertight for any cut" },
        { value: "marching-cubes", text: "Marching cubes", hint: "The paper's, cracks patched" },
      ],
      (mesher) => onEdit({ mesher }),
    );
    this.topology = new Segmented(
      "Topology",
      [
        { value: "preserve", text: "Preserve", hint: "Nothing vanishes and nothing closes" },
        { value: "free", text: "Free", hint: "Small parts may vanish" },
      ],
      (topology) => onEdit({ topology }),
    );
    this.maxError = new Select("Largest error", "Farthest that a decimated part may be from its surface", (value) => {
      onEdit({ maxError: value === "none" ? null : value.endsWith("vx") ? value : Number(value) });
    });
    this.polish = new Segmented(
      "Polish",
      [
        { value: "off", text: "Off", hint: "The surface as it is cut" },
        { value: "on", text: "On", hint: "Simplify the final surface once more" },
      ],
      (polish) => onEdit({ polish: polish === "on" }),
    );
    this.element = h(
      "details",
      { class: "advanced" },
      h("summary", {}, "Advanced"),
      row("Coarsest level", "Largest cube that may stand for the cells in it", this.maxLevel.element),
      row("Mesher", "What turns the cut into triangles", this.mesher.element),
      row("Topology", "Whether decimation may change it", this.topology.element),
      this.maxError.element,
      row("Polish", "Simplify the final surface once more, by quadrics", this.polish.element),
    );
  }

  set(view: View): void {
    this.maxLevel.set(view.maxLevel);
    this.mesher.set(view.mesher);
    this.topology.set(view.topology);
    this.polish.set(view.polish ? "on" : "off");
    const limit = view.maxError === null ? "none" : String(view.maxError);
    const limits = ERROR_LIMITS.includes(limit) ? ERROR_LIMITS : [...ERROR_LIMITS, limit];
    this.maxError.set(
      limits.map((value) => ({ value, text: errorLimitText(value) })),
      limit,
    );
  }
}

function errorLimitText(value: string): string {
  if (value === "none") return "No guard";
  return value.endsWith("vx") ? `${value.slice(0, -2)} of a sample's distance` : `${value} world units`;
}

/** Two significant digits: what a slider can be aimed at. */
function twoDigits(n: number): number {
  return Math.max(1, Number(n.toPrecision(2)));
}
