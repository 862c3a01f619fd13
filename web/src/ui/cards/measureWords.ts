/** What was measured, in words. Pure. */

import type { VolumeInfo } from "../../protocol/types";
import { amountOf, type Measure } from "../../state/measure";
import { formatValue } from "../format";

/** `34.2`, `41.3°`, `1.24`: as short as beside a line. */
export function amountWords(measure: Measure): string {
  if (measure.kind === "reading") return measure.values.map((value) => (value === null ? "–" : formatValue(value, 4))).join(" · ");
  const amount = amountOf(measure);
  if (Number.isNaN(amount)) return "no angle";
  return measure.kind === "angle" ? `${formatValue(amount, 4)}°` : formatValue(amount, 4);
}

/** A line of the list. @param spacing the volume's smallest one */
export function measureWords(measure: Measure, volume: Pick<VolumeInfo, "fields"> | undefined, spacing: number): string {
  switch (measure.kind) {
    case "distance":
      return `Distance ${amountWords(measure)}, ${formatValue(amountOf(measure) / spacing, 3)} voxels`;
    case "angle":
      return `Angle ${amountWords(measure)}`;
    case "reading": {
      const parts = measure.values.map((value, field) => {
        const { name = "value", unit = null } = volume?.fields[field] ?? {};
        return `${name} ${value === null ? "not known" : `${formatValue(value, 4)} ${unit ?? ""}`.trim()}`;
      });
      return parts.length === 0 ? "No values here" : parts.join(", ");
    }
  }
}
