/** How much is decimated: up to an error, a budget or β, and within which guards. */

import { LEVELS } from "../../protocol/generated";
import type { Edit, Statistics, View } from "../../protocol/types";
import { Segmented, Select, Slider, type Scale } from "../controls";
import { h, setText } from "../dom";
import { formatValue } from "../format";
import { criterion, gaveWayText, inSpacings, trianglesOf, type Criterion } from "./criterion";
import { row, section } from "./section";

/** β on the slider: the low end is the full surface, the rest four decades up to 1. */
export const BETA_SCALE: Scale = {
  toValue: (t) => (t <= 0 ? -1 : Number((10 ** (4 * (t - 1))).toPrecision(3))),
  toPosition: (beta) => (beta < 0 ? 0 : Math.min(1, Math.max(0.001, 1 + Math.log10(Math.max(beta, 1e-9)) / 4))),
};

/** Ends of the slider of the error, in multiples of the smallest spacing. */
const ERROR_RANGE = [0.01, 4] as const;

/** The error on the slider: equal steps are equal factors. */
export const ERROR_SCALE: Scale = {
  toValue: (t) => Number((ERROR_RANGE[0] * (ERROR_RANGE[1] / ERROR_RANGE[0]) ** t).toPrecision(2)),
  toPosition: (error) =>
    Math.min(1, Math.max(0, Math.log(Math.max(error, 1e-9) / ERROR_RANGE[0]) / Math.log(ERROR_RANGE[1] / ERROR_RANGE[0]))),
};

/** Low end of the slider of triangles. */
const MIN_TRIANGLES = 1000;

/** Where nothing else is known to begin with. */
const FIRST = { beta: 0.02, error: 0.1, triangles: 100_000 } as const;

export class DecimationSection {
  readonly element: HTMLElement;
  private readonly decides: Segmented<Criterion>;
  private readonly errorSlider: Slider;
  private readonly triangles: Slider;
  private readonly betaSlider: Slider;
  private readonly gaveWay = h("p", { class: "note gave-way", role: "status", hidden: true });
  private readonly guards: AdvancedControls;
  private view: View | undefined;
  /** The volume's smallest one. */
  private spacing = 1;
  /** Of the last final surface. */
  private statistics: Statistics | undefined;

  constructor(private readonly onEdit: (edit: Edit) => void) {
    this.decides = new Segmented(
      "Decide by",
      [
        { value: "error", text: "Error", hint: "Merge up to an error: more where importance is low" },
        { value: "triangles", text: "Triangles", hint: "The smallest error with at most so many triangles" },
        { value: "beta", text: "β (paper)", hint: "Decimate what is less important than β, as in the paper" },
      ],
      (by) => this.decideBy(by),
    );
    this.errorSlider = new Slider("Error", "Error up to which parts are merged, in multiples of the smallest distance between samples", {
      scale: ERROR_SCALE,
      min: 0,
      max: 1000,
      step: () => Math.max(1e-3, Number((this.error / 10).toPrecision(1))),
      describe: () => (this.budgetDecides ? `× spacing, in force ${this.toleranceText}` : "× spacing"),
      onChange: (error) => onEdit({ error: `${error}vx`, triangles: this.view?.triangles, bytes: this.view?.bytes }),
    });
    this.triangles = new Slider("Triangles", "The most triangles the surface may have", {
      scale: {
        toValue: (t) => twoDigits(MIN_TRIANGLES * (this.maxTriangles / MIN_TRIANGLES) ** t),
        toPosition: (n) => Math.min(1, Math.max(0, Math.log(n / MIN_TRIANGLES) / Math.log(this.maxTriangles / MIN_TRIANGLES))),
      },
      min: 1,
      max: Infinity,
      step: () => twoDigits((this.budget ?? MIN_TRIANGLES) / 10),
      describe: () => this.budgetText,
      onChange: (triangles) => onEdit({ triangles: Math.round(triangles), error: this.view?.error }),
    });
    this.betaSlider = new Slider("β", "Importance up to which a part is decimated; at the low end nothing is", {
      scale: BETA_SCALE,
      min: -1,
      max: 1,
      step: () => Math.max(1e-4, Number(((this.view?.beta ?? 0.01) / 10).toPrecision(1))),
      describe: (beta) => (beta < 0 ? "full surface" : "decimate up to"),
      onChange: (beta) => onEdit({ beta }),
    });
    this.guards = new AdvancedControls(onEdit);
    this.element = section(
      "Decimation",
      row("Decide by", "What decides how much is decimated", this.decides.element),
      this.errorSlider.element,
      this.triangles.element,
      this.betaSlider.element,
      this.gaveWay,
      this.guards.element,
    );
  }

  /** β, where it decides: the view's, or for marching cubes the one that was found for a budget. */
  get beta(): number | undefined {
    const found = this.view?.mesher === "marching-cubes" ? this.statistics?.beta : undefined;
    return this.view?.beta ?? found ?? undefined;
  }

  /** `spacing`: the volume's smallest one. */
  setView(view: View, spacing: number): void {
    this.view = view;
    this.spacing = spacing;
    this.guards.set(view);
    this.show();
  }

  setStatistics(statistics: Statistics | undefined): void {
    this.statistics = statistics;
    this.show();
  }

  private decideBy(by: Criterion): void {
    const { statistics, view } = this;
    switch (by) {
      case "error":
        // The paper's mesher knows β and budgets alone.
        return this.onEdit({ error: `${this.error}vx`, ...(view?.mesher === "marching-cubes" ? { mesher: "dual" } : {}) });
      case "triangles":
        return this.onEdit({ triangles: this.budget ?? twoDigits(statistics?.triangles ?? FIRST.triangles) });
      case "beta":
        return this.onEdit({ beta: Number((statistics?.beta ?? FIRST.beta).toPrecision(3)) });
    }
  }

  private show(): void {
    const { view, statistics, budget } = this;
    if (view === undefined) return;
    const hasBudget = view.triangles !== undefined || view.bytes !== undefined;
    this.decides.set(criterion(view, statistics, this.spacing));
    this.errorSlider.element.hidden = view.error === undefined;
    this.triangles.element.hidden = !hasBudget;
    this.betaSlider.element.hidden = view.error !== undefined || hasBudget;
    this.errorSlider.set(this.error);
    if (budget !== undefined) this.triangles.set(budget);
    if (view.beta !== undefined) this.betaSlider.set(view.beta);
    const texts = statistics === undefined ? [] : statistics.gaveWay.map((guard) => gaveWayText(guard, statistics, this.spacing));
    setText(this.gaveWay, texts.join(". "));
    this.gaveWay.hidden = texts.length === 0;
  }

  /** The view's error, or what would be the same as the present tolerance, in multiples of the spacing. */
  private get error(): number {
    if (this.view?.error !== undefined) return inSpacings(this.view.error, this.spacing);
    const tolerance = this.statistics?.tolerance ?? -1;
    return tolerance > 0 ? Number((tolerance / this.spacing).toPrecision(2)) : FIRST.error;
  }

  /** The view's budget in triangles; one in bytes is as many as were made for it. */
  private get budget(): number | undefined {
    const { view, statistics } = this;
    if (view?.bytes !== undefined) return statistics?.triangles;
    return view?.triangles === undefined ? undefined : trianglesOf(view.triangles, statistics?.fullTriangles);
  }

  private get budgetText(): string {
    const isByBudget = this.view?.error === undefined && (this.statistics?.tolerance ?? -1) >= 0;
    return isByBudget ? `at most, error ${this.toleranceText} × spacing` : "at most";
  }

  private get budgetDecides(): boolean {
    return this.view?.error !== undefined && criterion(this.view, this.statistics, this.spacing) === "triangles";
  }

  /** The tolerance in force in multiples of the spacing. */
  private get toleranceText(): string {
    return formatValue((this.statistics?.tolerance ?? 0) / this.spacing, 2);
  }

  /** High end of the slider of triangles: the full surface. */
  private get maxTriangles(): number {
    return Math.max(10 * MIN_TRIANGLES, this.statistics?.fullTriangles ?? 1_000_000);
  }
}

/** Limits on the error that are offered; another one that is in force is added. */
const ERROR_LIMITS = ["auto", "none", "0.1vx", "0.25vx", "0.5vx", "1vx"];

/** Guards, mesher and what else is changed rarely. */
class AdvancedControls {
  readonly element: HTMLElement;
  private readonly maxLevel: Segmented<number>;
  private readonly mesher: Segmented<View["mesher"]>;
  private readonly topology: Segmented<View["topology"]>;
  private readonly maxError: Select;
  private view: View | undefined;

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
      (mesher) => onEdit({ mesher, ...this.criterionOf(mesher) }),
    );
    this.topology = new Segmented(
      "Topology",
      [
        { value: "auto", text: "Auto", hint: "Nothing vanishes and nothing closes, unless a budget is too small for that" },
        { value: "preserve", text: "Preserve", hint: "Nothing vanishes and nothing closes, or the surface is refused" },
        { value: "free", text: "Free", hint: "Small parts may vanish" },
      ],
      (topology) => onEdit({ topology }),
    );
    this.maxError = new Select("Largest error", "Farthest that a decimated part may be from its surface", (value) => {
      onEdit({ maxError: value === "none" ? null : value === "auto" || value.endsWith("vx") ? value : Number(value) });
    });
    this.element = h(
      "details",
      { class: "advanced" },
      h("summary", {}, "Advanced"),
      row("Coarsest level", "Largest cube that may stand for the cells in it", this.maxLevel.element),
      row("Mesher", "What turns the cut into triangles", this.mesher.element),
      row("Topology", "Whether decimation may change it", this.topology.element),
      this.maxError.element,
    );
  }

  set(view: View): void {
    this.view = view;
    this.maxLevel.set(view.maxLevel);
    this.mesher.set(view.mesher);
    this.topology.set(view.topology);
    const limit = view.maxError === null ? "none" : String(view.maxError);
    const limits = ERROR_LIMITS.includes(limit) ? ERROR_LIMITS : [...ERROR_LIMITS, limit];
    this.maxError.set(
      limits.map((value) => ({ value, text: errorLimitText(value) })),
      limit,
    );
  }

  /** The paper's mesher knows no error: the budget beside it stays, or β takes its place. */
  private criterionOf(mesher: View["mesher"]): Edit {
    const { view } = this;
    if (mesher === "dual" || view?.error === undefined) return {};
    if (view.triangles !== undefined) return { triangles: view.triangles };
    return view.bytes === undefined ? { beta: FIRST.beta } : { bytes: view.bytes };
  }
}

function errorLimitText(value: string): string {
  if (value === "auto") return "Auto";
  if (value === "none") return "No guard";
  return value.endsWith("vx") ? `${value.slice(0, -2)} of a sample's distance` : `${value} world units`;
}

/** Two significant digits: what a slider can be aimed at. */
function twoDigits(n: number): number {
  return Math.max(1, Number(n.toPrecision(2)));
}
