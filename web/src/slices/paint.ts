/** A slice as pixels: samples between black and white. Pure. */

import { indexAlong } from "../world/places";
import type { Fit, SliceView } from "./view";

export interface PlaneSamples {
  /** Row after row, the lower of the plane's axes fastest; NaN is missing. */
  readonly samples: Float32Array;
  readonly size: readonly [number, number];
}

/** Of each pixel along a line the sample before it, or −1 outside, and how far it is on the way to the next. */
interface Stations {
  readonly low: Int32Array;
  readonly share: Float32Array;
}

export interface Painting {
  readonly width: number;
  readonly height: number;
  /** RGBA, row after row. */
  readonly pixels: Uint8ClampedArray<ArrayBuffer>;
}

/** Samples from one to the next along the view's two axes. */
export function stridesOf({ axes }: SliceView, [width]: PlaneSamples["size"]): readonly [number, number] {
  return axes[0] < axes[1] ? [1, width] : [width, 1];
}

/** The sample at indices along the view's two axes. */
export function sampleAt(view: SliceView, { samples, size }: PlaneSamples, i: number, j: number): number {
  const [across, down] = stridesOf(view, size);
  return samples[i * across + j * down] ?? NaN;
}

function stationsOf(view: SliceView, which: 0 | 1, count: number, start: number, step: number): Stations {
  const { grid, axes, signs } = view;
  const last = grid.dims[axes[which]] - 1;
  const low = new Int32Array(count).fill(-1);
  const share = new Float32Array(count);
  for (let pixel = 0; pixel < count; pixel += 1) {
    const index = indexAlong(grid, axes[which], signs[which] * (start + step * pixel));
    if (index < -0.5 || index > last + 0.5) continue;
    const inside = Math.min(last, Math.max(0, index));
    low[pixel] = Math.min(Math.floor(inside), Math.max(0, last - 1));
    share[pixel] = inside - (low[pixel] ?? 0);
  }
  return { low, share };
}

/**
 * Draws a slice into all of `painting`; what is outside or missing is transparent.
 * @param isSmooth values between samples are interpolated; else each pixel is that of the nearest sample
 */
export function paintSlice(painting: Painting, view: SliceView, plane: PlaneSamples, fit: Fit, [black, white]: readonly [number, number], isSmooth: boolean): void {
  const { width, height, pixels } = painting;
  const step = 1 / fit.scale;
  const rows = stationsOf(view, 1, height, ((0.5 - fit.top) * step) / view.skew[1], step / view.skew[1]);
  const columnsAt = (row: number) => {
    const y = (row + 0.5 - fit.top) * step;
    return stationsOf(view, 0, width, (0.5 - fit.left) * step - (view.skew[0] * y) / view.skew[1], step);
  };
  const columns = columnsAt(0);
  pixels.fill(0);
  for (let row = 0; row < height; row += 1) {
    if ((rows.low[row] ?? -1) < 0) continue;
    paintRow(painting, row, view, plane, [rows.low[row] ?? 0, rows.share[row] ?? 0], view.skew[0] === 0 ? columns : columnsAt(row), 255 / (white - black || 1), black, isSmooth);
  }
}

function paintRow({ width, pixels }: Painting, row: number, view: SliceView, { samples, size }: PlaneSamples, [low, t]: readonly [number, number], columns: Stations, gain: number, black: number, isSmooth: boolean): void {
  const [across, down] = stridesOf(view, size);
  // A missing sample that has no weight is not looked at.
  const [first, next] = [low * down, (t > 0 ? low + 1 : low) * down];
  for (let column = 0, at = 4 * row * width; column < width; column += 1, at += 4) {
    const left = columns.low[column] ?? -1;
    if (left < 0) continue;
    const s = columns.share[column] ?? 0;
    const [a, b] = [left * across, (s > 0 ? left + 1 : left) * across];
    let value = NaN;
    if (isSmooth) {
      const above = (1 - s) * (samples[first + a] ?? NaN) + s * (samples[first + b] ?? NaN);
      const below = (1 - s) * (samples[next + a] ?? NaN) + s * (samples[next + b] ?? NaN);
      value = (1 - t) * above + t * below;
    }
    // Beside a missing sample there is nothing to interpolate.
    if (value !== value) value = samples[(t < 0.5 ? first : next) + (s < 0.5 ? a : b)] ?? NaN;
    if (value !== value) continue;
    const grey = (value - black) * gain;
    pixels[at] = pixels[at + 1] = pixels[at + 2] = grey;
    pixels[at + 3] = 255;
  }
}
