/** What is known of the place under the pointer. */

import { For, Show } from "solid-js";
import type { Probed, VolumeInfo } from "../protocol/types";
import { type LengthScale, unitWord } from "../state/lengths";
import { formatLength, formatValue } from "./format";
import { useModel, useScale } from "./model";
import { placeOf } from "./surfaceNames";

type Row = readonly [string, string];

/** Names and values of what was found. */
export function probeRows({ values, nearest }: Probed, volume: VolumeInfo | undefined, scale: LengthScale): readonly Row[] {
  const unit = (name: string) => volume?.fields.find((field) => field.name === name)?.unit ?? "";
  const fields = values.flatMap(({ field, value }): Row[] => (value === null ? [] : [[field, `${formatValue(value, 4)} ${unit(field)}`.trim()]]));
  if (nearest === null) return fields;
  const rows: Row[] = [
    ["importance", formatValue(nearest.importance, 2)],
    ["importance input", formatValue(nearest.blended, 2)],
  ];
  if (nearest.partArea !== null) rows.push(["area of this part", `${formatValue(nearest.partArea, 3)} ${unitWord(scale.unit, 2)}`]);
  if (nearest.leaf === null) return [...fields, ...rows];
  const { level, error } = nearest.leaf;
  return [...fields, ...rows, ["level", String(level)], ["error", `≈ ${formatLength(error, scale)}`]];
}

export function ProbeReadout() {
  const { probe, surfaces, volume } = useModel();
  const rows = (probed: Probed): readonly Row[] => {
    const several: Row[] = surfaces().length > 1 ? [["surface", String(placeOf(surfaces(), probed.surface))]] : [];
    return [...several, ...probeRows(probed, volume(), scale())];
  };
  const scale = useScale();
  return (
    <Show when={probe()}>
      {(probed) => (
        <dl class="probe rows" aria-label="Under the pointer">
          <For each={rows(probed())}>
            {([name, value]) => (
              <>
                <dt>{name}</dt>
                <dd>{value}</dd>
              </>
            )}
          </For>
        </dl>
      )}
    </Show>
  );
}
