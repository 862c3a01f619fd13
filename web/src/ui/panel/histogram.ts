/** Histograms as curves. Pure. */

import type { Histogram } from "../../protocol/types";

/**
 * SVG path of a histogram over [low, high], on a logarithmic scale (data have peaks that hide everything else).
 * The curve is closed along the bottom.
 */
export function histogramPath(histogram: Histogram, low: number, high: number, width: number, height: number): string {
  const { counts, min, max } = histogram;
  const bin = (max - min) / counts.length;
  if (!(high > low) || !(bin > 0)) return "";
  const steps = 104;
  const step = (high - low) / steps;
  // The mean of the bins in a step: integers in more bins than values would give a comb.
  const means = Array.from({ length: steps }, (_, i) => {
    const first = Math.max(0, Math.floor((low + i * step - min) / bin + 1e-6));
    const last = Math.min(counts.length, Math.max(first + 1, Math.ceil((low + (i + 1) * step - min) / bin - 1e-6)));
    const covered = counts.slice(first, last);
    return covered.length === 0 ? 0 : covered.reduce((sum, n) => sum + n, 0) / covered.length;
  });
  const peak = Math.log1p(Math.max(...means));
  if (peak === 0) return "";
  const points = means.map((mean, i) => {
    const y = Math.log1p(mean) / peak;
    return `${((width * (i + 0.5)) / steps).toFixed(1)} ${(height * (1 - 0.94 * y)).toFixed(1)}`;
  });
  return `M0 ${height}L${points.join("L")}L${width} ${height}Z`;
}
