/** What is known of a volume and its fields, in words. Pure. */

import type { FieldInfo, VolumeInfo } from "../../protocol/types";
import { lengthUnit, unitWord } from "../../state/lengths";
import { sidesOf } from "../../world/axes";
import { digitsBetween, formatBytes, formatCount, formatShare, formatValue } from "../format";
import type { Row } from "./rows";

type Geometry = VolumeInfo["geometry"];

const product = (values: readonly number[], digits = 5) => values.map((value) => formatValue(value, digits)).join(" × ");
const list = (values: readonly number[], digits = 5) => values.map((value) => formatValue(Math.abs(value) < 1e-9 ? 0 : value, digits)).join(", ");

const samplesOf = ({ dims }: Pick<Geometry, "dims">): number => dims.reduce((all, n) => all * n, 1);

/** Bytes of a sample on the device. */
const BYTES: Readonly<Record<string, number>> = { u8: 1, i8: 1, u16: 2, i16: 2, f32: 4 };
/** The histogram of a larger volume is of a share of its planes. */
const MAX_COUNTED = 2 ** 27;

const FRAMES: Readonly<Record<string, string>> = {
  world: "not stated by the file",
  index: "coordinates are sample indices",
};

/** `LPS: x to the left, y to the back (posterior), z to the head (superior)`. */
export function frameText(frame: string): string {
  const sides = sidesOf(frame);
  const along = (["+x", "+y", "+z"] as const).flatMap((axis) => (sides[axis] === undefined ? [] : [`${axis.slice(1)} to the ${sides[axis].word}`]));
  return along.length > 0 ? `${frame}: ${along.join(", ")}` : (FRAMES[frame] ?? frame);
}

function spacingText({ spacing, positions }: Geometry): string {
  const texts = spacing.map((mean, axis) => {
    const steps = positions?.[axis]?.slice(1).map((at, i) => at - (positions[axis]?.[i] ?? 0));
    return steps === undefined ? formatValue(mean) : `${formatValue(Math.min(...steps), 3)}…${formatValue(Math.max(...steps), 3)}`;
  });
  return texts.join(" × ");
}

/** @param step the time step that is shown, in words; `undefined`: there is one alone */
export function volumeRows(volume: VolumeInfo, step: string | undefined): readonly Row[] {
  const { geometry, id, title } = volume;
  const unit = unitWord(lengthUnit(volume));
  const lengths = geometry.dims.map((n, axis) => (n - 1) * (geometry.spacing[axis] ?? 1));
  return [
    ["Volume", title],
    ...(id === title ? [] : [["Name in links", id] as const]),
    ...(step === undefined ? [] : [["Time step", step] as const]),
    ["Samples", `${product(geometry.dims)} (${formatCount(samplesOf(geometry))})`],
    ["Spacing", `${spacingText(geometry)} ${unit}`],
    ["Size", `${product(lengths, 4)} ${unit}`],
    ["Origin", `${list(geometry.origin)} ${unit}`],
    ["Axes", frameText(geometry.frame)],
  ];
}

/** World coordinates from sample numbers: three rows of four. Along uneven axes with the mean spacing. */
export function affineOf({ direction, spacing, origin }: Geometry): readonly (readonly string[])[] {
  return [0, 1, 2].map((world) => [...direction.map((axis, i) => (axis[world] ?? 0) * (spacing[i] ?? 1)), origin[world] ?? 0].map((value) => formatValue(Math.abs(value) < 1e-9 ? 0 : value)));
}

/** `1.2 % of the samples`; `undefined` if the histogram does not tell. */
export function missingText({ histogram }: Pick<FieldInfo, "histogram">, geometry: Pick<Geometry, "dims">): string | undefined {
  const all = samplesOf(geometry);
  if (all > MAX_COUNTED) return undefined;
  const missing = all - histogram.counts.reduce((sum, n) => sum + n, 0);
  return missing <= 0 ? "none" : `${formatShare(missing / all)} of the samples (${formatCount(missing)})`;
}

export function fieldRows(field: FieldInfo, geometry: Geometry): readonly Row[] {
  const [low, high] = field.range;
  const digits = digitsBetween(low, high);
  const stored = field.storedType === undefined || field.storedType === field.type ? "" : `, ${field.storedType} in the file`;
  const missing = missingText(field, geometry);
  const bytes = BYTES[field.type];
  return [
    ["Type", `${field.type}${stored}`],
    ["Unit", field.unit ?? "not stated"],
    ["Range", `${formatValue(low, digits)} to ${formatValue(high, digits)}`],
    ...(missing === undefined ? [] : [["Missing values", missing] as const]),
    ...(field.labels === undefined ? [] : [["Names of labels", formatCount(field.labels.length)] as const]),
    ...(bytes === undefined ? [] : [["On the device", formatBytes(bytes * samplesOf(geometry))] as const]),
  ];
}
