/** Where the surface may be coarse: feature, its weight, the transfer function, and regions of interest. */

import type { Edit, FieldInfo, View, VolumeInfo } from "../../protocol/types";
import type { Points } from "../../transfer/model";
import { LINEAR, NumberField, Select, Slider, button } from "../controls";
import { h, setText } from "../dom";
import { featureInfo, label, NO_FEATURE, ownRange } from "./features";
import { section } from "./section";
import { TransferEditor } from "./transferEditor";

/** How many regions of interest there are. */
export function interestText(count: number): string {
  return count === 1 ? "1 region of interest" : `${count} regions of interest`;
}

export interface ImportanceHandlers {
  readonly onEdit: (edit: Edit) => void;
  readonly onPoints: (points: Points) => void;
}

export class ImportanceSection {
  readonly element: HTMLElement;
  readonly editor: TransferEditor;
  private readonly feature: Select;
  private readonly low: NumberField;
  private readonly high: NumberField;
  private readonly unit = h("span", { class: "unit" });
  private readonly rangeRow: HTMLElement;
  private readonly alpha: Slider;
  private readonly interestCount = h("span", { class: "label", title: "Spheres and boxes in which importance is raised" });
  private readonly interestRow: HTMLElement;
  private volume: VolumeInfo | undefined;
  private view: View | undefined;

  constructor(private readonly handlers: ImportanceHandlers) {
    this.feature = new Select("Feature", "What matters besides smoothness", (name) => this.chooseFeature(name));
    this.low = new NumberField("Feature value that becomes 0", {
      step: () => this.rangeStep(),
      onChange: (low) => this.changeRange(low, this.view?.featureRange?.[1] ?? Infinity),
    });
    this.high = new NumberField("Feature value that becomes 1", {
      step: () => this.rangeStep(),
      onChange: (high) => this.changeRange(this.view?.featureRange?.[0] ?? -Infinity, high),
    });
    this.rangeRow = h(
      "div",
      { class: "control row" },
      h("span", { class: "label", title: "Feature values that become 0 and 1" }, "Range"),
      h("span", { class: "pair" }, this.low.element, h("span", {}, "to"), this.high.element, this.unit),
    );
    this.alpha = new Slider("α", "Weight of the feature against smoothness: 0 is smoothness alone, 1 the feature alone", {
      scale: LINEAR,
      min: 0,
      max: 1,
      step: () => 0.01,
      describe: () => "feature against smoothness",
      onChange: (alpha) => handlers.onEdit({ alpha }),
    });
    this.editor = new TransferEditor(handlers.onPoints);
    this.interestRow = h(
      "div",
      { class: "control row", hidden: true },
      this.interestCount,
      button("Remove", "Remove all regions of interest", () => handlers.onEdit({ interest: [] })),
    );
    this.element = section("Importance", this.feature.element, this.rangeRow, this.alpha.element, this.editor.element, this.interestRow);
  }

  set(volume: VolumeInfo, view: View): void {
    const before = this.volume === volume ? this.view : undefined;
    this.volume = volume;
    this.view = view;
    const named = (info: FieldInfo) => ({ value: info.name, text: label(info.name) });
    this.feature.set([{ value: NO_FEATURE, text: label(NO_FEATURE) }, ...volume.features.map(named)], view.feature);
    const none = view.feature === NO_FEATURE;
    this.rangeRow.hidden = none;
    this.showRange(volume, view);
    this.alpha.disabled = none;
    this.alpha.set(view.alpha);
    this.interestRow.hidden = view.interest.length === 0;
    setText(this.interestCount, interestText(view.interest.length));
    const same = before?.field === view.field && before.feature === view.feature && before.featureRange === view.featureRange;
    if (!same) this.showBackground(volume, view);
  }

  private rangeStep(): number {
    const [low, high] = this.view?.featureRange ?? [0, 1];
    return Number(((high - low) / 50).toPrecision(1));
  }

  private changeRange(low: number, high: number): void {
    if (low < high) this.handlers.onEdit({ featureRange: [low, high] });
    else if (this.volume !== undefined && this.view !== undefined) this.showRange(this.volume, this.view);
  }

  private showRange(volume: VolumeInfo, view: View): void {
    const range = view.featureRange;
    this.low.set(range?.[0] ?? NaN);
    this.high.set(range?.[1] ?? NaN);
    for (const field of [this.low, this.high]) field.disabled = range === undefined;
    this.rangeRow.title = range === undefined ? "The feature's own range, which only the server knows" : "";
    setText(this.unit, featureInfo(volume, view)?.unit ?? "");
  }

  private showBackground(volume: VolumeInfo, view: View): void {
    const field = volume.fields.find((f) => f.name === view.field);
    const info = view.feature === NO_FEATURE ? undefined : featureInfo(volume, view);
    const range = view.featureRange;
    this.editor.setBackground(
      {
        data: field?.histogram,
        feature: info === undefined || range === undefined ? undefined : { histogram: info.histogram, range },
      },
      { data: `data: ${label(view.field)}`, feature: `feature: ${label(view.feature)}` },
    );
  }

  private chooseFeature(name: string): void {
    const { volume, view } = this;
    if (volume === undefined || view === undefined) return;
    const featureRange = ownRange(featureInfo(volume, { feature: name, field: view.field }));
    this.handlers.onEdit({ feature: name, featureRange });
  }
}
