/** Histograms as curves. Pure. */

import type { FieldInfo, Histogram } from "../../protocol/types";

/** Columns of a curve. */
const STEPS = 104;

/**
 * SVG path of a histogram over [low, high], on a logarithmic scale (data have peaks that hide everything else).
 * The curve is closed along the bottom.
 * @param part of the histogram: the curve is then in each column as high as the share of this part
 */
export function histogramPath(histogram: Histogram, low: number, high: number, width: number, height: number, part?: Histogram): string {
  const means = columns(histogram, low, high);
  const parts = part === undefined ? means : columns(part, low, high);
  const peak = Math.log1p(Math.max(0, ...means));
  if (peak === 0) return "";
  const points = means.map((mean, i) => {
    const y = mean > 0 ? (Math.log1p(mean) / peak) * ((parts[i] ?? 0) / mean) : 0;
    return `${((width * (i + 0.5)) / STEPS).toFixed(1)} ${(height * (1 - 0.94 * y)).toFixed(1)}`;
  });
  return `M0 ${height}L${points.join("L")}L${width} ${height}Z`;
}

/** The mean of the bins in each column: integers in more bins than values would give a comb. */
function columns({ counts, min, max }: Histogram, low: number, high: number): readonly number[] {
  const bin = (max - min) / counts.length;
  if (!(high > low) || !(bin > 0)) return [];
  const step = (high - low) / STEPS;
  return Array.from({ length: STEPS }, (_, i) => {
    const first = Math.max(0, Math.floor((low + i * step - min) / bin + 1e-6));
    const last = Math.min(counts.length, Math.max(first + 1, Math.ceil((low + (i + 1) * step - min) / bin - 1e-6)));
    const covered = counts.slice(first, last);
    return covered.length === 0 ? 0 : covered.reduce((sum, n) => sum + n, 0) / covered.length;
  });
}

/** Whether any sample has a value: a volume may be all NaN, or all missing. */
export function hasValues({ histogram }: FieldInfo): boolean {
  return histogram.counts.some((count) => count > 0);
}
