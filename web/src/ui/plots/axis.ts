/** Axes of a histogram: positions of counts and values. Pure. */

import type { Histogram } from "../../protocol/types";

export type CountScale = "linear" | "log";

/** Height of a count, 0 to 1. */
export function heightOf(count: number, peak: number, scale: CountScale): number {
  if (!(peak > 0) || count <= 0) return 0;
  return scale === "linear" ? count / peak : Math.log10(1 + count) / Math.log10(1 + peak);
}

/** Steps of a path over all bins, closed along the bottom. */
export function stepPath({ counts }: Pick<Histogram, "counts">, scale: CountScale, width: number, height: number): string {
  const peak = Math.max(0, ...counts);
  const bin = width / counts.length;
  const steps = counts.map((count, i) => {
    const y = (height * (1 - heightOf(count, peak, scale))).toFixed(1);
    return `${(i * bin).toFixed(1)} ${y}L${((i + 1) * bin).toFixed(1)} ${y}`;
  });
  return `M0 ${height}L${steps.join("L")}L${width} ${height}Z`;
}

/** Counts with a line across the plot: round ones, or powers of ten. */
export function countTicks(peak: number, scale: CountScale): readonly number[] {
  if (!(peak > 0)) return [];
  if (scale === "log") {
    const powers = Array.from({ length: Math.floor(Math.log10(peak)) + 1 }, (_, power) => 10 ** power);
    // Lines that are nearer to each other could not be told apart.
    const every = Math.ceil(powers.length / 4);
    return powers.filter((_, power) => power > 0 && power % every === 0);
  }
  const power = 10 ** Math.floor(Math.log10(peak / 2));
  const step = [5, 2, 1].map((digit) => digit * power).find((size) => size <= peak / 2) ?? power;
  return [step, 2 * step, 3 * step].filter((count) => count <= peak);
}

/** `1.2 M`, `35 k`: short enough for an axis. */
export function shortCount(count: number): string {
  for (const [size, letter] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]] as const) {
    if (count >= size) return `${Number((count / size).toPrecision(2))} ${letter}`;
  }
  return String(count);
}

/** The bin at a share of the width: its values and its samples. */
export function binAt({ min, max, counts }: Histogram, share: number): { readonly low: number; readonly high: number; readonly count: number } {
  const bin = Math.min(counts.length - 1, Math.max(0, Math.floor(share * counts.length)));
  const width = (max - min) / counts.length;
  return { low: min + bin * width, high: min + (bin + 1) * width, count: counts[bin] ?? 0 };
}
