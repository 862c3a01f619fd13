/** Colours of a field in its units: from which value to which, linear or logarithmic, and isolines. Pure. */

import type { View, VolumeInfo } from "../../protocol/types";
import { isExpression } from "../../state/expressions";
import type { Look } from "../../state/look";
import { roundBelow } from "../../world/ticks";
import { formatValue } from "../format";
import { featureInfo, label, NO_FEATURE } from "./features";

export interface FieldScale {
  /** Whether vertices have values of the field, instead of the feature alone. */
  readonly ofValues: boolean;
  /** Values at which the vertices' feature is 0 and 1: beyond them it is not known. Of values, the range of the field. */
  readonly known: readonly [number, number];
  /** Values of the first and the last colour. */
  readonly range: readonly [number, number];
  /** A logarithmic scale; its range is above 0. */
  readonly log: boolean;
  /** Values of the isolines, ascending. */
  readonly lines: readonly number[];
}

/** Decades that a logarithmic scale has if its range begins at 0 or below. */
const DECADES = 3;

/** The field or feature that the colours of mode `field` are of. */
const coloredField = ({ colorField, feature }: Pick<View, "colorField" | "feature">): string => colorField ?? feature;

/** The expression that the colours of mode `field` are of; `undefined` if they are of a field or a feature. */
export function colorExpression(view: View | undefined, volume: VolumeInfo | undefined): string | undefined {
  const name = view?.colorField;
  return volume !== undefined && typeof name === "string" && isExpression(volume, name) ? name : undefined;
}

/** The range of the colours if none is chosen; `undefined` if it is not known, as that of an expression. */
function ownColorRange(view: View, volume: VolumeInfo | undefined): readonly [number, number] | undefined {
  if (view.colorField === null) return view.feature === NO_FEATURE ? undefined : view.featureRange;
  const range = volume?.fields.find(({ name }) => name === view.colorField)?.range;
  if (range === undefined) return undefined;
  // A field that has one value everywhere.
  return range[0] < range[1] ? range : [range[0], range[0] + Math.max(1, Math.abs(range[0]))];
}

/** How a surface's field is coloured; `undefined` if it has none, or its range is not known yet. @param legend the view whose field the legend shows */
export function fieldScaleOf(look: Look, view: View, volume: VolumeInfo | undefined, legend = view): FieldScale | undefined {
  const own = ownColorRange(view, volume);
  const chosen = (coloredField(view) === coloredField(legend) && coloredField(view) !== NO_FEATURE ? look.colorRange : undefined) ?? own;
  if (chosen === undefined) return undefined;
  const ofValues = view.colorField !== null;
  const known = own ?? (ofValues ? chosen : undefined);
  if (known === undefined) return undefined;
  const log = look.logColors && chosen[1] > 0;
  const range = log && !(chosen[0] > 0) ? ([chosen[1] / 10 ** DECADES, chosen[1]] as const) : chosen;
  return { ofValues, known, range, log, lines: isolinesOf(range, log, look.isolines) };
}

/** Why the scale is not as it was asked for; `undefined` if it is. */
export function logProblem(look: Look, view: View, volume: VolumeInfo | undefined): "begins-above-0" | "linear" | undefined {
  const [low, high] = look.colorRange ?? ownColorRange(view, volume) ?? [1, 2];
  if (!look.logColors || low > 0) return undefined;
  return high > 0 ? "begins-above-0" : "linear";
}

/** Position of a value between the first colour and the last: 0 to 1 within the range. */
function positionOf({ range: [low, high], log }: FieldScale, value: number): number {
  return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

/** The value at a position: the inverse of `positionOf`. */
export function valueAt({ range: [low, high], log }: FieldScale, position: number): number {
  return log ? low * (high / low) ** position : low + position * (high - low);
}

/** Steps in which the server sends the feature, from 0 to 1. */
const STEPS = 65535 / 256;

/**
 * Positions of isolines between the first colour and the last. The feature comes in steps, so whole triangles may have the same value. An
 * isoline at such a value is moved by a quarter of a step: else all of such a triangle would be line. Values of a field need no such steps.
 */
export function linePlaces(scale: FieldScale): readonly number[] {
  const { ofValues, known: [from, to], lines } = scale;
  if (ofValues) return lines.map((value) => positionOf(scale, value));
  return lines.map((value) => {
    const step = ((value - from) / (to - from)) * STEPS;
    const near = Math.round(step);
    return positionOf(scale, Math.abs(step - near) < 0.25 ? from + ((near + 0.25) / STEPS) * (to - from) : value);
  });
}

/** What the legend says of a field: `texts` from the lowest up, equidistant, and the positions of isolines. */
export interface FieldBar {
  readonly title: string;
  readonly texts: readonly string[];
  readonly lines: readonly { readonly at: number; readonly text: string }[];
}

/** Texts nearer to each other than this would overlap, as a share of the bar. */
const NEAREST_TEXTS = 0.09;

export function fieldBarOf(scale: FieldScale, view: View, volume: VolumeInfo | undefined): FieldBar {
  const feature = coloredField(view);
  const unit = volume && featureInfo(volume, view.colorField === null ? view : { field: "", feature })?.unit;
  const title = unit === null || unit === undefined ? label(feature) : `${label(feature)}, in ${unit}`;
  const [low, high] = scale.range;
  if (scale.lines.length === 0) return { title, texts: [low, valueAt(scale, 0.5), high].map((value) => formatValue(value)), lines: [] };
  let last = 0;
  const lines = scale.lines.map((value) => {
    const at = positionOf(scale, value);
    const hasSpace = at - last >= NEAREST_TEXTS && at <= 1 - NEAREST_TEXTS;
    if (hasSpace) last = at;
    return { at, text: hasSpace ? formatValue(Number(value.toPrecision(9))) : "" };
  });
  return { title, texts: [formatValue(low), formatValue(high)], lines };
}

/** Multiples of the smallest of 1, 2 and 5 times a power of ten that gives no more than `count`. */
function linearLines(low: number, high: number, count: number): readonly number[] {
  const lines = (step: number) => Array.from({ length: Math.max(0, Math.ceil(high / step - 1e-9) - Math.floor(low / step + 1e-9) - 1) }, (_, i) => (Math.floor(low / step + 1e-9) + 1 + i) * step);
  for (let step = roundBelow((high - low) / (count + 1)); ; step = roundBelow(step * 2.5)) {
    const found = lines(step);
    if (found.length <= count) return found.map((value) => Number(value.toPrecision(12)));
  }
}

/** Round values inside a range, at most `count` of them. */
function isolinesOf([low, high]: readonly [number, number], log: boolean, count: number): readonly number[] {
  if (count < 1 || !(low < high)) return [];
  const inside = (values: readonly number[]) => values.filter((value) => value > low && value < high);
  if (!log || high / low < 10) return linearLines(low, high, count);
  const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
  const decades = Array.from({ length: last - first + 1 }, (_, i) => first + i);
  const within = [[1, 2, 3, 4, 5, 6, 7, 8, 9], [1, 2, 5], [1]].map((digits) => decades.flatMap((decade) => digits.map((digit) => digit * 10 ** decade)));
  const apart = decades.map((step) => decades.filter((decade) => decade % (step - first + 2) === 0).map((decade) => 10 ** decade));
  return [...within, ...apart].map(inside).find((values) => values.length <= count) ?? [];
}
