/** What was measured, in words. Pure. */

import type { VolumeInfo } from "../../protocol/types";
import type { LengthScale } from "../../state/lengths";
import { amountOf, type Measure } from "../../state/measure";
import { formatValue } from "../format";

/** `34.2`, `34.2 mm` if the unit is known, `41.3°`, `1.24`: short enough to stand beside a line. */
export function amountWords(measure: Measure, unit: string | undefined): string {
  if (measure.kind === "reading") return measure.values.map((value) => (value === null ? "–" : formatValue(value, 4))).join(" · ");
  if (measure.kind === "label") return measure.text;
  const amount = amountOf(measure);
  if (Number.isNaN(amount)) return "no angle";
  if (measure.kind === "angle") return `${formatValue(amount, 4)}°`;
  return `${formatValue(amount, 4)} ${unit ?? ""}`.trim();
}

/** A line of the list. */
export function measureWords(measure: Measure, volume: Pick<VolumeInfo, "fields"> | undefined, { spacing, unit }: LengthScale): string {
  switch (measure.kind) {
    case "distance":
      return `Distance ${amountWords(measure, unit)}, ${formatValue(amountOf(measure) / spacing, 3)} voxels`;
    case "angle":
      return `Angle ${amountWords(measure, unit)}`;
    case "label":
      return measure.text;
    case "reading": {
      const parts = measure.values.map((value, field) => {
        const { name = "value", unit = null } = volume?.fields[field] ?? {};
        return `${name} ${value === null ? "not known" : `${formatValue(value, 4)} ${unit ?? ""}`.trim()}`;
      });
      return parts.length === 0 ? "No values here" : parts.join(", ");
    }
  }
}
