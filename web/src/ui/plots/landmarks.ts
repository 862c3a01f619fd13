/** Isovalues worth trying: the one a field opens with, the threshold between two classes of values, and peaks. Pure. */

import type { FieldInfo, Histogram } from "../../protocol/types";
import { digitsBetween, formatValue } from "../format";

export interface Landmark {
  readonly name: string;
  readonly iso: number;
  /** Why it is offered. */
  readonly why: string;
}

const MAX_PEAKS = 2;
/** Landmarks that are nearer to each other than this share of the range are one. */
const APART = 0.03;
/** A further surface is by more than this share of the range from the others. */
const FURTHER = 0.06;
/** Share of the samples at either end in which no surface is put. */
const TAIL = 0.02;
/** A peak stands out of its surroundings by this factor. */
const STANDS_OUT = 1.25;
/** Bins to each side over which counts are averaged: less is noise. */
const SMOOTH = 3;

/** Isovalues at which surfaces of the body begin in computed tomography, Hounsfield units. */
const HOUNSFIELD: readonly Landmark[] = [
  { name: "lung", iso: -600, why: "Air and lung against tissue, −600 HU" },
  { name: "skin", iso: -200, why: "The body against the air around it, −200 HU" },
  { name: "vessels", iso: 150, why: "Blood with contrast agent, above soft tissue, 150 HU" },
  { name: "bone", iso: 300, why: "Bone, 300 HU" },
  { name: "metal", iso: 2500, why: "Implants and fillings, 2500 HU" },
];

/** `brought`: the isovalue that the volume itself brings along. */
export function landmarks(field: FieldInfo, brought?: number): readonly Landmark[] {
  const { histogram } = field;
  const width = histogram.max - histogram.min;
  if (!(width > 0)) return [];
  const found: Landmark[] = [];
  const peaked = peaks(histogram).slice(0, MAX_PEAKS).map((peak): Landmark => {
    const iso = readable(peak, width);
    return { name: `peak ${formatValue(iso, digitsBetween(histogram.min, histogram.max) - 1)}`, iso, why: "Values that occur often: a material, or noise around one" };
  });
  const { min, max } = histogram;
  // If tissues have names, the value that separates the values best is left out: it has no name.
  const known = isHounsfield(field) ? HOUNSFIELD.filter(({ iso }) => iso > min && iso < max) : [...otsu(histogram, width), ...peaked];
  for (const mark of [...thresholds(field, brought), ...known]) {
    if (found.every(({ iso }) => Math.abs(iso - mark.iso) > APART * width)) found.push(mark);
  }
  return found;
}

/** By the file's unit, or because the server found bone. */
function isHounsfield({ unit, openingIso }: FieldInfo): boolean {
  return unit?.trim().toUpperCase() === "HU" || openingIso?.reason === "bone";
}

/** What the volume and the server open with. */
function thresholds({ openingIso }: FieldInfo, brought: number | undefined): readonly Landmark[] {
  const found: Landmark[] = [];
  const add = (mark: Landmark) => found.push(mark);
  if (brought !== undefined) add({ name: "default", iso: brought, why: "The volume opens here" });
  if (openingIso !== undefined && openingIso.reason !== "no-surface") {
    const name = openingIso.reason === "bone" ? "bone" : brought === undefined ? "default" : "threshold";
    add({ name, iso: openingIso.iso, why: `Chosen from the values: ${openingIso.explanation}` });
  }
  return found;
}

/** The threshold between two classes of values; empty if there is one class. */
function otsu(histogram: Histogram, width: number): readonly Landmark[] {
  const threshold = otsuThreshold(histogram);
  return threshold === undefined ? [] : [{ name: "Otsu threshold", iso: readable(threshold, width), why: "Separates the values into two classes (Otsu's threshold)" }];
}

/**
 * An isovalue at which a further surface shows something else: a threshold between classes of values, or the middle of the widest gap
 * between the surfaces there are.
 * @param taken their isovalues
 */
export function furtherIsovalue(field: FieldInfo, brought: number | undefined, taken: readonly number[]): number {
  const { histogram } = field;
  const width = histogram.max - histogram.min;
  if (!(width > 0)) return histogram.min;
  const free = [...thresholds(field, brought), ...otsu(histogram, width)].find(({ iso }) => taken.every((other) => Math.abs(iso - other) > FURTHER * width));
  if (free !== undefined) return free.iso;
  const [low, high] = [quantile(histogram, TAIL), quantile(histogram, 1 - TAIL)];
  const marks = [low, ...taken.filter((iso) => iso > low && iso < high), high].sort((a, b) => a - b);
  const gaps = marks.slice(1).map((to, i) => ({ size: to - (marks[i] ?? low), middle: (to + (marks[i] ?? low)) / 2 }));
  return readable(gaps.reduce((a, b) => (b.size > a.size ? b : a)).middle, width);
}

/** The value below which this share of the samples is. */
function quantile(histogram: Histogram, share: number): number {
  const { counts } = histogram;
  const total = counts.reduce((sum, n) => sum + n, 0);
  let below = 0;
  const bin = counts.findIndex((n) => (below += n) >= share * total);
  return centre(histogram, Math.max(0, bin));
}

/** Three digits of the range are enough for a place in a histogram. */
function readable(value: number, width: number): number {
  const unit = 10 ** (Math.floor(Math.log10(width)) - 2);
  return Number((Math.round(value / unit) * unit).toPrecision(12));
}

const centre = ({ min, max, counts }: Histogram, bin: number) => min + ((max - min) * (bin + 0.5)) / counts.length;

/** The threshold with the minimum spread within the two classes that it separates; `undefined` if there is one class. */
function otsuThreshold(histogram: Histogram): number | undefined {
  const { counts } = histogram;
  const total = counts.reduce((sum, n) => sum + n, 0);
  const moment = counts.reduce((sum, n, bin) => sum + n * bin, 0);
  let [below, belowMoment, best, at] = [0, 0, 0, -1];
  counts.forEach((n, bin) => {
    below += n;
    belowMoment += n * bin;
    const above = total - below;
    if (below === 0 || above === 0) return;
    const apart = belowMoment / below - (moment - belowMoment) / above;
    const between = below * above * apart * apart;
    if (between > best) [best, at] = [between, bin];
  });
  return at < 0 ? undefined : centre(histogram, at + 0.5);
}

/** Values of local maxima that stand out, the highest first; not the ends, at which values are cut off or missing. */
function peaks(histogram: Histogram): readonly number[] {
  const { counts } = histogram;
  const smooth = counts.map((_, bin) => {
    const window = counts.slice(Math.max(0, bin - SMOOTH), bin + SMOOTH + 1);
    return Math.log1p(window.reduce((sum, n) => sum + n, 0) / window.length);
  });
  const found: { bin: number; height: number }[] = [];
  for (let bin = 2 * SMOOTH; bin < counts.length - 2 * SMOOTH; bin += 1) {
    const height = smooth[bin] ?? 0;
    const around = smooth.slice(bin - 2 * SMOOTH, bin + 2 * SMOOTH + 1);
    if (height < Math.max(...around) || found.some((peak) => bin - peak.bin <= 2 * SMOOTH)) continue;
    const saddles = [Math.min(...smooth.slice(0, bin)), Math.min(...smooth.slice(bin + 1))];
    if (Math.exp(height - Math.max(...saddles)) > STANDS_OUT) found.push({ bin, height });
  }
  return found.sort((a, b) => b.height - a.height).map(({ bin }) => centre(histogram, bin));
}
