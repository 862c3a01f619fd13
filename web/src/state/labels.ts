/** Labels of a segmentation as objects: which there are, the surface around one, the distance to it, a mask to it. Pure. */

import type { Edit, FieldInfo, View, VolumeInfo } from "../protocol/types";
import { hasLabels } from "./fields";
import { listHas, maskText, readMask, toggled } from "./mask";
import { DEFAULT_STYLE, freeNumber, OUTER_OPACITY, type Surface, type SurfaceList } from "./surfaceList";

/** A label as the list has it. */
export interface LabelEntry {
  /** As conditions have it: the number in the file. */
  readonly number: number;
  readonly name: string;
  readonly color: string;
  /** Samples with it; `undefined` if the histogram does not tell it apart from others. */
  readonly samples: number | undefined;
}

/** Isovalue halfway between samples inside and outside. */
const HALFWAY = 0.5;
/** Standard deviation, in samples, that takes the stairs of a segmentation away. */
export const SMOOTHING = 0.8;
/** Labels that one surface is around at most: an expression has 64 operations. */
const MAX_JOINED = 16;
/** As many as a condition takes. */
const MAX_VALUES = 64;
/** Distance at which nothing matters any more, as a share of the volume's longest side. */
const REACH = 0.1;
/** Of larger volumes a share of the planes is counted. */
const MAX_COUNTED = 2 ** 27;

export function labelFields(volume: VolumeInfo | undefined): readonly FieldInfo[] {
  return (volume?.fields ?? []).filter(hasLabels);
}

/**
 * The labels of a field in ascending order, without the background and without those that no sample has. Of a field without a table those
 * that its histogram tells apart.
 */
export function labelsIn(field: FieldInfo, { dims }: Pick<VolumeInfo["geometry"], "dims">): readonly LabelEntry[] {
  const isCounted = dims.reduce((product, n) => product * n, 1) <= MAX_COUNTED;
  const background = backgroundOf(field);
  const known = field.labels?.map(({ value, stored, name, color }) => ({ value, number: Number(stored ?? value), name, color }));
  const all = known ?? valuesOf(field).map((value) => ({ value, number: value, name: null, color: null }));
  return all.flatMap(({ value, number, name, color }) => {
    const samples = isCounted ? samplesWith(field, value) : "unknown";
    if (value === background || samples === 0) return [];
    return [{ number, name: name ?? `Label ${number}`, color: color ?? colorFor(number), samples: typeof samples === "number" ? samples : undefined }];
  });
}

/** A label that the list does not have, by its number; `undefined` if the field cannot have it. */
export function labelByNumber(field: FieldInfo, text: string): LabelEntry | undefined {
  const number = /^\s*-?\d+\s*$/.test(text) ? Number(text) : NaN;
  const [low, high] = field.range;
  if (!(number >= low && number <= high) || number === backgroundOf(field)) return undefined;
  return { number, name: `Label ${number}`, color: colorFor(number), samples: undefined };
}

/** Those whose name has a text in it, or whose number begins with it. */
export function matching(labels: readonly LabelEntry[], text: string): readonly LabelEntry[] {
  const sought = text.trim().toLowerCase();
  return sought === "" ? labels : labels.filter(({ name, number }) => name.toLowerCase().includes(sought) || String(number).startsWith(sought));
}

function backgroundOf({ labels, openingIso, range: [low] }: FieldInfo): number | undefined {
  if (openingIso?.reason === "labels") return low;
  return labels === undefined || low === 0 ? 0 : undefined;
}

const isFine = ({ histogram: { min, max, counts } }: FieldInfo) => max - min < counts.length;

/** Whole numbers that the field has, if each has a bin of its own. */
function valuesOf(field: FieldInfo): readonly number[] {
  const [low, high] = field.range;
  if (!isFine(field) || !Number.isInteger(low)) return [];
  return Array.from({ length: high - low + 1 }, (_, i) => low + i).filter((value) => samplesWith(field, value) !== 0);
}

/** Samples with a value; 0 if there are none, `unknown` if a bin has more values than one. */
function samplesWith(field: FieldInfo, value: number): number | "unknown" {
  const { min, max, counts } = field.histogram;
  if (value < min || value > max) return 0;
  const bin = max > min ? Math.min(counts.length - 1, Math.floor(((value - min) * counts.length) / (max - min))) : 0;
  const count = counts[bin] ?? 0;
  return count === 0 || isFine(field) ? count : "unknown";
}

/** Volume of `samples` samples, in cubed world units; `undefined` if cells differ in size. */
export function samplesVolume(samples: number, { spacing, direction, positions }: VolumeInfo["geometry"]): number | undefined {
  if (positions?.some((along) => along !== null) === true) return undefined;
  const [a, b, c] = direction;
  const skew = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
  return samples * Math.abs(skew) * spacing[0] * spacing[1] * spacing[2];
}

/** A colour for a label without one: neighbours in number are far apart in hue. */
export function colorFor(number: number): string {
  const hue = (((number * 137.508) % 360) + 360) % 360;
  const light = [0.62, 0.52, 0.7][((number % 3) + 3) % 3] ?? 0.62;
  const part = (shift: number) => {
    const k = (shift + hue / 30) % 12;
    const value = light - 0.55 * Math.min(light, 1 - light) * Math.max(-1, Math.min(k - 3, 9 - k, 1));
    return Math.round(255 * value).toString(16).padStart(2, "0");
  };
  return `#${part(0)}${part(8)}${part(4)}`;
}

/** Labels of a field that an expression is about. */
export interface LabelChoice {
  readonly field: string;
  /** Numbers and ranges, as a mask has them. */
  readonly values: string;
  readonly smoothing: number;
}

/** The expression whose surface at one half is that around some labels. */
export function around({ field, values, smoothing }: LabelChoice): string {
  if (smoothing > 0) return `smooth(${smoothing},${field}==${values})`;
  const quote = field.includes('"') ? "`" : '"';
  return `if(${values.split(",").map((value) => `${quote}${field}${quote}==${value}`).join("||")},1,0)`;
}

/** The labels that the surface of a field is around; `undefined` if it is another surface. Reads expressions of the command line too. */
export function labelsAround(expression: string): LabelChoice | undefined {
  const [, sigma, inner] = /^smooth\(\s*([\d.]+)\s*,(.*)\)$/s.exec(expression) ?? [];
  if (sigma !== undefined && inner !== undefined) {
    const of = joinedLabels(inner);
    return of && { ...of, smoothing: Number(sigma) };
  }
  const [, condition] = /^if\((.*),\s*1\s*,\s*0\s*\)$/s.exec(expression) ?? [];
  const of = condition === undefined ? undefined : joinedLabels(condition);
  return of && { ...of, smoothing: 0 };
}

/** `labels==3,17`, or `"labels"==3||"labels"==17`. */
function joinedLabels(condition: string): Pick<LabelChoice, "field" | "values"> | undefined {
  const each = condition.split("||").map((part) => readMask(part));
  const [first] = each;
  if (first === undefined || !each.every((mask) => mask?.comparison === "==" && mask.field === first.field)) return undefined;
  return { field: first.field, values: each.map((mask) => mask?.values).join(",") };
}

/** The labels of a field to which a feature is the distance; empty if the feature is none of these. */
export function labelsNear(feature: string, field: string): string {
  const [, condition] = /^distance\((.*)\)$/s.exec(feature) ?? [];
  const of = condition === undefined ? undefined : joinedLabels(condition);
  return of?.field === field ? of.values : "";
}

/** The labels of a field that a mask keeps; empty if it does something else. */
export function labelsKept(mask: string | null, field: string): string {
  const read = mask === null ? undefined : readMask(mask);
  return read?.field === field && read.comparison === "==" ? read.values : "";
}

/** A list with a label or without it. */
function withLabel(values: string, number: number, all: readonly LabelEntry[]): string {
  if (values.includes("..")) return toggled(values, number, [...new Set([...all.map((label) => label.number), number])].sort((a, b) => a - b));
  const list = values === "" ? [] : values.split(",");
  const rest = list.filter((item) => Number(item) !== number);
  return (rest.length < list.length ? rest : [...list, String(number)]).slice(-MAX_VALUES).join(",");
}

/** The edit after which importance falls with the distance to a label too, or no longer. */
export function importanceEdit(view: View, field: string, label: LabelEntry, all: readonly LabelEntry[], { opening, extent }: { readonly opening: View; readonly extent: number }): Edit {
  const before = labelsNear(view.feature, field);
  const values = withLabel(before, label.number, all);
  if (values === "") {
    const { feature, featureRange, alpha, transferFunction } = opening;
    return { feature, featureRange, alpha, transferFunction };
  }
  const feature = `distance(${field}==${values})`;
  // What the user has made of the distance stays.
  if (before !== "") return { feature, featureRange: view.featureRange };
  const { points } = opening.transferFunction;
  const [far, near] = [points[0]?.color ?? "#3465a4", points.at(-1)?.color ?? "#f57900"];
  return {
    feature,
    featureRange: [0, Number((REACH * extent).toPrecision(2))],
    alpha: 1,
    transferFunction: { points: [{ x: 0, importance: 1, color: near }, { x: 1, importance: 0, color: far }] },
  };
}

/** The edit that adds a label to those at which the surface may be, or removes it. Without labels the surface is everywhere. */
export function maskEdit(view: View, field: string, label: LabelEntry, all: readonly LabelEntry[]): Edit {
  const values = withLabel(labelsKept(view.mask, field), label.number, all);
  return { mask: values === "" ? null : maskText({ field, comparison: "==", values }) };
}

/** The surfaces around a label, alone or with others. */
export function surfacesAround(surfaces: SurfaceList, field: string, number: number): SurfaceList {
  return surfaces.filter(({ view }) => {
    const of = labelsAround(view.field);
    return of?.field === field && listHas(of.values, number);
  });
}

export const isAround = ({ view }: Surface): boolean => labelsAround(view.field) !== undefined;

/** What a surface around labels is made with. */
export interface LabelSurface {
  readonly field: string;
  readonly label: LabelEntry;
  readonly smoothing: number;
  /** With what the volume opens. */
  readonly opening: View;
  /** Surfaces that there may be. */
  readonly max: number;
}

/**
 * The list after a label's surface is shown or hidden. A known surface is hidden or shown again, a new one is made. If there are as many
 * surfaces as there can be, the new one takes the place of a hidden one around labels. `undefined` if there is no place for it.
 */
export function shownLabel(surfaces: SurfaceList, of: LabelSurface): SurfaceList | undefined {
  const { field, label, max } = of;
  const known = surfacesAround(surfaces, field, label.number);
  if (known.length > 0) {
    const visible = known.every(({ style }) => !style.visible);
    return surfaces.map((surface) => (known.includes(surface) ? { ...surface, style: { ...surface.style, visible } } : surface));
  }
  const number = surfaces.length < max ? freeNumber(surfaces) : undefined;
  if (number !== undefined) return [...seenThrough(surfaces), surfaceOf(number, of, surfaces)];
  const hidden = surfaces.find((surface) => isAround(surface) && !surface.style.visible);
  return hidden && surfaces.map((surface) => (surface === hidden ? surfaceOf(hidden.number, of, surfaces) : surface));
}

function surfaceOf(number: number, { field, label, smoothing, opening }: LabelSurface, surfaces: SurfaceList): Surface {
  const { error, triangles, bytes, beta, mesher } = surfaces[0]?.view ?? opening;
  const view: View = {
    ...opening,
    ...{ error, triangles, bytes, beta, mesher },
    field: around({ field, values: String(label.number), smoothing }),
    iso: HALFWAY,
    // Gradients of 0 and 1 say nothing.
    feature: "none",
    featureRange: undefined,
  };
  return { number, view, style: { ...DEFAULT_STYLE, color: label.color } };
}

/** With the first surface around labels the others let it be seen: mostly they lie around it. */
function seenThrough(surfaces: SurfaceList): SurfaceList {
  if (surfaces.some(isAround)) return surfaces;
  return surfaces.map((surface) => (surface.style.opacity === 1 ? { ...surface, style: { ...surface.style, opacity: OUTER_OPACITY } } : surface));
}

/**
 * The list in which the last surface around labels of the field is around this one too; `undefined` if there is none, or it has as many as
 * it can.
 */
export function joinedLabel(surfaces: SurfaceList, { field, label }: Pick<LabelSurface, "field" | "label">): SurfaceList | undefined {
  const last = surfaces.findLast(({ view }) => labelsAround(view.field)?.field === field);
  const of = last && labelsAround(last.view.field);
  if (last === undefined || of === undefined || of.values.split(",").length >= MAX_JOINED) return undefined;
  const joined = around({ ...of, values: `${of.values},${label.number}` });
  return surfaces.map((surface) => (surface === last ? { ...surface, view: { ...surface.view, field: joined }, style: { ...surface.style, visible: true } } : surface));
}

/** The list with all surfaces around labels smoothed, or none but those around ranges, which a condition of `if` does not take. */
export function smoothedLabels(surfaces: SurfaceList, smoothing: number): SurfaceList {
  return surfaces.map((surface) => {
    const of = labelsAround(surface.view.field);
    const isLeft = of === undefined || (smoothing === 0 && of.values.includes(".."));
    return isLeft ? surface : { ...surface, view: { ...surface.view, field: around({ ...of, smoothing }) } };
  });
}

/** The name of a surface around labels; `undefined` if it is another surface. */
export function labelsName(volume: Pick<VolumeInfo, "fields"> | undefined, expression: string): string | undefined {
  const of = labelsAround(expression);
  if (of === undefined) return undefined;
  const labels = volume?.fields.find(({ name }) => name === of.field)?.labels ?? [];
  const names = of.values.split(",").map((value) => labels.find((label) => String(label.stored ?? label.value) === value)?.name ?? value);
  const text = names.length > 3 ? `${names.slice(0, 2).join(", ")} and ${names.length - 2} more` : names.join(", ");
  return names.every((name) => /^[-\d.]+$/.test(name)) ? `${names.length > 1 ? "Labels" : "Label"} ${text}` : text;
}
