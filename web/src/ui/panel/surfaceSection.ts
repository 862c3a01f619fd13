/** Which isosurface is shown: field and isovalue. */

import type { FieldInfo, View, VolumeInfo } from "../../protocol/types";
import { NumberField, Select } from "../controls";
import { h, setText } from "../dom";
import { formatValue } from "../format";
import { label } from "./features";
import { HistogramSlider } from "./histogramSlider";
import { section } from "./section";

/** Why a field opens with this isovalue; empty where it is another one. */
export function openingText(field: FieldInfo | undefined, iso: number): string {
  const opening = field?.openingIso;
  return opening?.iso === iso ? `Opens here: ${opening.explanation}` : "";
}

export interface SurfaceHandlers {
  readonly onField: (name: string) => void;
  readonly onIsovalue: (iso: number) => void;
}

export class SurfaceSection {
  readonly element: HTMLElement;
  private readonly field: Select;
  private readonly iso: HistogramSlider;
  private readonly isoField: NumberField;
  private readonly unit = h("span", { class: "unit" });
  private readonly low = h("span");
  private readonly high = h("span");
  private readonly why = h("p", { class: "note", hidden: true });
  private range: readonly [number, number] = [0, 1];

  constructor(handlers: SurfaceHandlers) {
    this.field = new Select("Field", "Field whose isosurface is shown", handlers.onField);
    this.iso = new HistogramSlider("Isovalue", (iso) => {
      this.isoField.set(iso);
      handlers.onIsovalue(iso);
    });
    this.isoField = new NumberField("Isovalue", {
      step: () => (this.range[1] - this.range[0]) / 256,
      onChange: (iso) => {
        this.iso.set(iso);
        handlers.onIsovalue(iso);
      },
    });
    const { field, iso, isoField, unit, low, high, why } = this;
    this.element = section(
      "Surface",
      field.element,
      h(
        "div",
        { class: "control" },
        h("div", { class: "control-head" }, h("span", { class: "label" }, "Isovalue"), h("span", { class: "spring" }), unit, isoField.element),
        iso.element,
        h("div", { class: "axis-labels" }, low, high),
        why,
      ),
    );
  }

  set(volume: VolumeInfo, view: View): void {
    const named = (info: FieldInfo) => ({ value: info.name, text: label(info.name) });
    this.field.set(volume.fields.map(named), view.field);
    const field = volume.fields.find((f) => f.name === view.field);
    this.range = field?.range ?? [0, 1];
    if (field !== undefined) {
      this.iso.setHistogram(field.histogram);
      setText(this.unit, field.unit ?? "");
      setText(this.low, formatValue(field.histogram.min));
      setText(this.high, formatValue(field.histogram.max));
    }
    this.iso.set(view.iso);
    this.isoField.set(view.iso);
    const why = openingText(field, view.iso);
    this.why.hidden = why === "";
    setText(this.why, why);
  }
}
