/** Histograms as curves, and a threshold found in one. Pure. */

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

/** The threshold with the largest variance between the parts below and above it (Otsu 1979): a first isovalue for a field. */
export function otsuThreshold({ counts, min, max }: Histogram): number {
  const bin = (max - min) / counts.length;
  const total = counts.reduce((sum, n) => sum + n, 0);
  const moment = counts.reduce((sum, n, i) => sum + n * i, 0);
  let below = 0;
  let momentBelow = 0;
  let best = 0;
  let cut = counts.length / 2;
  counts.forEach((n, i) => {
    below += n;
    momentBelow += n * i;
    const above = total - below;
    if (below === 0 || above === 0) return;
    const between = below * above * (momentBelow / below - (moment - momentBelow) / above) ** 2;
    if (between > best) [best, cut] = [between, i + 1];
  });
  return min + bin * cut;
}
