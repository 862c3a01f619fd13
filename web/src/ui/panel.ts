/** The side panel: what is shown, where its surface lies, and where it may be coarse. */

import { LEVELS, type DerivedInfo, type View, type FieldInfo, type Edit, type Statistics, type VolumeInfo, type VolumeSummary } from "../protocol/types";
import type { Points } from "../transfer/model";
import { LINEAR, NumberField, Segmented, Select, Slider, type Scale } from "./controls";
import { h, setText } from "./dom";
import { formatBytes, formatCount, formatMs, formatValue } from "./format";
import { HistogramSlider, otsuThreshold } from "./histogram";
import { TransferEditor } from "./transferEditor";

const NO_FEATURE = "none";
const DERIVED = "gradient-magnitude";

/** β on the slider: the low end is the full surface, the rest four decades up to 1. */
export const BETA_SCALE: Scale = {
  toValue: (t) => (t <= 0 ? -1 : Number((10 ** (4 * (t - 1))).toPrecision(3))),
  toTravel: (beta) => (beta < 0 ? 0 : Math.min(1, Math.max(0.001, 1 + Math.log10(Math.max(beta, 1e-9)) / 4))),
};

export interface PanelHandlers {
  readonly onVolume: (id: string) => void;
  readonly onStep: (step: number) => void;
  readonly onEdit: (change: Edit) => void;
  readonly onPoints: (points: Points) => void;
}

/** Histogram and range of the feature in force; `undefined` where the server told nothing of it. */
export function featureInfo(volume: VolumeInfo, edit: Pick<View, "feature" | "field">): DerivedInfo | undefined {
  const named = (name: string) => volume.fields.find((f) => f.name === name);
  return edit.feature === DERIVED ? named(edit.field)?.gradientMagnitude : named(edit.feature);
}

/** The feature's own range, as far as it is known and not empty. */
function ownRange(info: DerivedInfo | undefined): readonly [number, number] | undefined {
  return info !== undefined && info.range[0] < info.range[1] ? info.range : undefined;
}

export class Panel {
  readonly element: HTMLElement;
  readonly editor: TransferEditor;
  private volume: VolumeInfo | undefined;
  private edit: View | undefined;

  private readonly volumes: Select;
  private readonly facts = h("p", { class: "facts" });
  private readonly step: Slider;
  private steps = 1;
  private readonly field: Select;
  private readonly iso: HistogramSlider;
  private readonly isoField: NumberField;
  private readonly isoUnit = h("span", { class: "unit" });
  private readonly isoRange = h("div", { class: "axis-labels" }, h("span"), h("span"));
  private readonly feature: Select;
  private readonly low: NumberField;
  private readonly high: NumberField;
  private readonly featureUnit = h("span", { class: "unit" });
  private readonly rangeRow: HTMLElement;
  private readonly alpha: Slider;
  private readonly quality: Segmented<"beta" | "triangles">;
  private readonly beta: Slider;
  private readonly triangles: Slider;
  /** Of the last final surface: what β was found, how many triangles it has and the full one would. */
  private made: Statistics | undefined;
  private readonly mesher: Segmented<View["mesher"]>;
  private readonly topology: Segmented<View["topology"]>;
  private readonly maxError: Select;
  private readonly polish: Segmented<"off" | "on">;
  private readonly maxLevel: Segmented<number>;
  private readonly statistics = h("dl", { class: "statistics" });
  private readonly edits: HTMLFieldSetElement;

  constructor(private readonly handlers: PanelHandlers) {
    const change = (edit: Edit) => this.handlers.onEdit(edit);
    this.volumes = new Select("Volume", "Volume to look at", (id) => this.handlers.onVolume(id));
    this.step = new Slider("Time step", "Time step of the volume", {
      scale: {
        toValue: (t) => Math.round(t * (this.steps - 1)),
        toTravel: (step) => (this.steps > 1 ? step / (this.steps - 1) : 0),
      },
      min: 0,
      max: Infinity,
      step: () => 1,
      onChange: (step) => this.handlers.onStep(Math.min(this.steps - 1, Math.round(step))),
    });
    this.field = new Select("Field", "Field whose isosurface is shown", (name) => this.chooseField(name));
    this.iso = new HistogramSlider("Isovalue", (iso) => {
      this.isoField.set(iso);
      change({ iso });
    });
    this.isoField = new NumberField("Isovalue", {
      step: () => {
        const [low, high] = this.fieldInfo()?.range ?? [0, 1];
        return (high - low) / 256;
      },
      onChange: (iso) => {
        this.iso.set(iso);
        change({ iso });
      },
    });
    this.feature = new Select("Feature", "What matters besides smoothness", (name) => this.chooseFeature(name));
    const range = (low: number, high: number) => {
      if (low < high) change({ featureRange: [low, high] });
      else this.showRange();
    };
    this.low = new NumberField("Feature value that becomes 0", {
      step: () => this.rangeStep(),
      onChange: (low) => range(low, this.edit?.featureRange?.[1] ?? Infinity),
    });
    this.high = new NumberField("Feature value that becomes 1", {
      step: () => this.rangeStep(),
      onChange: (high) => range(this.edit?.featureRange?.[0] ?? -Infinity, high),
    });
    this.rangeRow = h(
      "div",
      { class: "control row" },
      h("span", { class: "label", title: "Feature values that become 0 and 1" }, "Range"),
      h("span", { class: "pair" }, this.low.element, h("span", {}, "to"), this.high.element, this.featureUnit),
    );
    this.alpha = new Slider("α", "Weight of the feature against smoothness: 0 is smoothness alone, 1 the feature alone", {
      scale: LINEAR,
      min: 0,
      max: 1,
      step: () => 0.01,
      describe: () => "feature against smoothness",
      onChange: (alpha) => change({ alpha }),
    });
    this.beta = new Slider("β", "Importance up to which a part is decimated; at the low end nothing is", {
      scale: BETA_SCALE,
      min: -1,
      max: 1,
      step: () => Math.max(1e-4, Number(((this.edit?.beta ?? 0.01) / 10).toPrecision(1))),
      describe: (beta) => (beta < 0 ? "full surface" : "decimate up to"),
      onChange: (beta) => change({ beta }),
    });
    this.quality = new Segmented(
      "Decide by",
      [
        { value: "beta", text: "β", hint: "Decimate what is less important than β" },
        { value: "triangles", text: "Triangles", hint: "Find the β that gives at most so many triangles" },
      ],
      (by) => {
        if (by === "beta") change({ beta: Number((this.made?.beta ?? 0.02).toPrecision(3)) });
        else change({ triangles: roughly(this.made?.triangles ?? 100_000) });
      },
    );
    this.triangles = new Slider("Triangles", "The most triangles the surface may have", {
      scale: {
        toValue: (t) => roughly(FEWEST * (this.most() / FEWEST) ** t),
        toTravel: (n) => Math.min(1, Math.max(0, Math.log(n / FEWEST) / Math.log(this.most() / FEWEST))),
      },
      min: 1,
      max: Infinity,
      step: () => roughly((this.edit?.triangles ?? FEWEST) / 10),
      describe: () => (this.made === undefined ? "at most" : `at most, β ${formatValue(this.made.beta, 3)}`),
      onChange: (triangles) => change({ triangles: Math.round(triangles) }),
    });
    this.mesher = new Segmented(
      "Mesher",
      [
        { value: "dual", text: "Dual", hint: "Watertight for any cut" },
        { value: "marching-cubes", text: "Marching cubes", hint: "The paper's, cracks patched" },
      ],
      (mesher) => change({ mesher }),
    );
    this.topology = new Segmented(
      "Topology",
      [
        { value: "preserve", text: "Preserve", hint: "Nothing vanishes and nothing closes" },
        { value: "free", text: "Free", hint: "Small parts may vanish" },
      ],
      (topology) => change({ topology }),
    );
    this.maxError = new Select("Largest error", "Farthest that a decimated part may be from its surface", (value) => {
      change({ maxError: value === "none" ? null : value.endsWith("vx") ? value : Number(value) });
    });
    this.polish = new Segmented(
      "Polish",
      [
        { value: "off", text: "Off", hint: "The surface as it is cut" },
        { value: "on", text: "On", hint: "Simplify the final surface once more" },
      ],
      (polish) => change({ polish: polish === "on" }),
    );
    this.editor = new TransferEditor((points) => this.handlers.onPoints(points));
    this.maxLevel = new Segmented(
      "Coarsest level",
      Array.from({ length: LEVELS }, (_, level) => ({
        value: level,
        text: String(level),
        hint: level === 0 ? "No cube is merged" : `Cubes of up to ${2 ** level} cells per axis`,
      })),
      (maxLevel) => change({ maxLevel }),
    );

    this.edits = h(
      "fieldset",
      { class: "edits", disabled: true },
      section(
        "Surface",
        this.field.element,
        h(
          "div",
          { class: "control" },
          h("div", { class: "control-head" }, h("span", { class: "label" }, "Isovalue"), h("span", { class: "spring" }), this.isoUnit, this.isoField.element),
          this.iso.element,
          this.isoRange,
        ),
      ),
      section(
        "Decimation",
        row("Decide by", "What decides how much is decimated", this.quality.element),
        this.beta.element,
        this.triangles.element,
        h(
          "details",
          { class: "advanced" },
          h("summary", {}, "Advanced"),
          row("Coarsest level", "Largest cube that may stand for the cells in it", this.maxLevel.element),
          row("Mesher", "What turns the cut into triangles", this.mesher.element),
          row("Topology", "Whether decimation may change it", this.topology.element),
          this.maxError.element,
          row("Polish", "Simplify the final surface once more, by quadrics", this.polish.element),
        ),
      ),
      section("Importance", this.feature.element, this.rangeRow, this.alpha.element, this.editor.element),
    );
    this.element = h(
      "aside",
      { class: "panel", "aria-label": "Controls" },
      section("", this.volumes.element, this.facts, this.step.element),
      this.edits,
      h("details", { class: "section" }, h("summary", {}, "Statistics"), this.statistics),
    );
    this.step.element.hidden = true;
    this.setStatistics(undefined);
  }

  setVolumes(volumes: readonly VolumeSummary[], open: string | undefined): void {
    this.volumes.set(
      volumes.map((v) => ({ value: v.id, text: v.title })),
      open,
    );
  }

  /** A volume is open at a step; `setEdit` follows. */
  setVolume(volume: VolumeInfo, step: number): void {
    this.volume = volume;
    // Histograms of another step, perhaps: `setEdit` shows them as it would after any change.
    this.edit = undefined;
    const { dims, spacing } = volume.geometry;
    const shape = (values: readonly number[]) => values.map((v) => formatValue(v, 4)).join(" × ");
    setText(this.facts, `${shape(dims)} samples, ${shape(spacing)} apart`);
    this.steps = volume.steps;
    this.step.element.hidden = volume.steps < 2;
    this.step.set(step);
    this.edits.disabled = false;
  }

  /** Values in force. */
  setEdit(edit: View): void {
    const { volume } = this;
    if (volume === undefined) return;
    const before = this.edit;
    this.edit = edit;
    const field = this.fieldInfo();
    const named = (info: FieldInfo) => ({ value: info.name, text: label(info.name) });
    this.field.set(volume.fields.map(named), edit.field);
    if (field !== undefined) {
      this.iso.setHistogram(field.histogram);
      setText(this.isoUnit, field.unit ?? "");
      const [first, last] = this.isoRange.children;
      if (first !== undefined) setText(first, formatValue(field.histogram.min));
      if (last !== undefined) setText(last, formatValue(field.histogram.max));
    }
    this.iso.set(edit.iso);
    this.isoField.set(edit.iso);
    this.feature.set([{ value: NO_FEATURE, text: label(NO_FEATURE) }, ...volume.features.map(named)], edit.feature);
    const without = edit.feature === NO_FEATURE;
    this.rangeRow.hidden = without;
    this.showRange();
    this.alpha.disabled = without;
    this.alpha.set(edit.alpha);
    this.maxLevel.set(edit.maxLevel);
    this.mesher.set(edit.mesher);
    this.topology.set(edit.topology);
    this.polish.set(edit.polish ? "on" : "off");
    const guard = edit.maxError === null ? "none" : String(edit.maxError);
    const guards = GUARDS.includes(guard) ? GUARDS : [...GUARDS, guard];
    this.maxError.set(guards.map((value) => ({ value, text: guardText(value) })), guard);
    this.showQuality();
    if (
      before?.field !== edit.field ||
      before.feature !== edit.feature ||
      before.featureRange !== edit.featureRange
    ) {
      this.showBackground();
    }
  }

  /** β, or the budget and the β that was found for it. */
  private showQuality(): void {
    const { edit } = this;
    if (edit === undefined) return;
    const budget = edit.triangles !== undefined;
    this.quality.set(budget ? "triangles" : "beta");
    this.beta.element.hidden = budget;
    this.triangles.element.hidden = !budget;
    const beta = edit.beta ?? this.made?.beta;
    if (beta !== undefined) this.beta.set(beta);
    if (edit.triangles !== undefined) this.triangles.set(edit.triangles);
    this.editor.setThreshold(beta ?? -1);
  }

  /** The slider's high end: the full surface. */
  private most(): number {
    return Math.max(10 * FEWEST, this.made?.full_triangles ?? 1_000_000);
  }

  setStatistics(statistics: Statistics | undefined): void {
    this.made = statistics;
    this.showQuality();
    if (statistics === undefined) {
      this.statistics.replaceChildren(h("dt", {}, "No surface yet"), h("dd"));
      return;
    }
    const st = statistics;
    const kept = st.full_triangles > 0 ? ` (${((100 * st.triangles) / st.full_triangles).toFixed(1)} %)` : "";
    const rows: [string, string][] = [
      ["Triangles", `${formatCount(st.triangles)}${kept}`],
      ["Full surface", formatCount(st.full_triangles)],
      ["β in force", formatValue(st.beta, 3)],
      ["Error, rms", st.error === null ? "not stated" : formatValue(st.error.rms, 3)],
      ["Error, greatest", st.error === null ? "not stated" : formatValue(st.error.max, 3)],
      ["Vertices", formatCount(st.vertices)],
      ["Active cells", formatCount(st.active_cells)],
      ["Leaves, level 0 to 5", st.leaves.map(formatCount).join(" · ")],
      ["Lost cubes", formatCount(st.lost_cubes)],
      ["Unpatched vertices", formatCount(st.unpatched_vertices)],
      ...Object.entries(st.stages_ms).map(([stage, ms]): [string, string] => [`Stage ${stage}`, `${ms.toFixed(2)} ms`]),
      ["Server, all stages", formatMs(st.wall_ms)],
      ["Device memory", `${formatBytes(st.device_bytes)} + volume ${formatBytes(st.volume_bytes)}`],
    ];
    this.statistics.replaceChildren(...rows.flatMap(([term, value]) => [h("dt", {}, term), h("dd", {}, value)]));
  }

  private fieldInfo(): FieldInfo | undefined {
    return this.volume?.fields.find((f) => f.name === this.edit?.field);
  }

  private rangeStep(): number {
    const [low, high] = this.edit?.featureRange ?? [0, 1];
    return Number(((high - low) / 50).toPrecision(1));
  }

  private showRange(): void {
    const range = this.edit?.featureRange;
    this.low.set(range?.[0] ?? NaN);
    this.high.set(range?.[1] ?? NaN);
    for (const field of [this.low, this.high]) field.disabled = range === undefined;
    this.rangeRow.title = range === undefined ? "The feature's own range, which only the server knows" : "";
    const info = this.volume && this.edit ? featureInfo(this.volume, this.edit) : undefined;
    setText(this.featureUnit, info?.unit ?? "");
  }

  private showBackground(): void {
    const { volume, edit } = this;
    if (volume === undefined || edit === undefined) return;
    const field = this.fieldInfo();
    const info = edit.feature === NO_FEATURE ? undefined : featureInfo(volume, edit);
    const range = edit.featureRange;
    this.editor.setBackground(
      {
        data: field?.histogram,
        feature: info === undefined || range === undefined ? undefined : { histogram: info.histogram, range },
      },
      { data: `data: ${label(edit.field)}`, feature: `feature: ${label(edit.feature)}` },
    );
  }

  private chooseField(name: string): void {
    const { volume, edit } = this;
    const field = volume?.fields.find((f) => f.name === name);
    if (volume === undefined || edit === undefined || field === undefined) return;
    const iso = Number(formatValue(otsuThreshold(field.histogram), 4));
    // Another field's gradient is another feature, with another range.
    const derived = edit.feature === DERIVED;
    const featureRange = derived ? ownRange(featureInfo(volume, { feature: DERIVED, field: name })) : edit.featureRange;
    this.handlers.onEdit({ field: name, iso, ...(derived ? { featureRange } : {}) });
  }

  private chooseFeature(name: string): void {
    const { volume, edit } = this;
    if (volume === undefined || edit === undefined) return;
    const featureRange = ownRange(featureInfo(volume, { feature: name, field: edit.field }));
    this.handlers.onEdit({ feature: name, featureRange });
  }
}

/** Low end of the slider of triangles. */
const FEWEST = 1000;

/** Guards on the error that are offered; another one that is in force joins them. */
const GUARDS = ["none", "0.1vx", "0.25vx", "0.5vx", "1vx"];

function guardText(value: string): string {
  if (value === "none") return "No guard";
  return value.endsWith("vx") ? `${value.slice(0, -2)} of a sample's distance` : `${value} world units`;
}

/** Two significant digits: what a slider can be aimed at. */
function roughly(n: number): number {
  return Math.max(1, Number(n.toPrecision(2)));
}

function row(title: string, hint: string, element: HTMLElement): HTMLElement {
  return h("div", { class: "control row" }, h("span", { class: "label", title: hint }, title), element);
}

function section(title: string, ...children: HTMLElement[]): HTMLElement {
  return h("section", { class: "section" }, title === "" ? undefined : h("h2", {}, title), ...children);
}

/** Names as people read them; what comes from files stays as it is. */
function label(name: string): string {
  return name === DERIVED ? "Gradient magnitude" : name === NO_FEATURE ? "None" : name;
}
