/** Bounds of the volume in the world, and of its values. Pure. */

import type { Vec3, VolumeInfo } from "../protocol/types";

export interface Bounds {
  readonly min: Vec3;
  readonly max: Vec3;
}

/** Around all samples, along the world's axes. */
export function boundsOf({ dims, spacing, origin, direction }: VolumeInfo["geometry"]): Bounds {
  const corners = Array.from({ length: 8 }, (_, corner) =>
    [0, 1, 2].map((world) =>
      [0, 1, 2].reduce((sum, axis) => {
        const index = corner & (1 << axis) ? (dims[axis] ?? 1) - 1 : 0;
        return sum + (direction[axis]?.[world] ?? 0) * (spacing[axis] ?? 1) * index;
      }, origin[world] ?? 0),
    ),
  );
  const pick = (of: (...values: number[]) => number) => [0, 1, 2].map((axis) => of(...corners.map((corner) => corner[axis] ?? 0))) as unknown as Vec3;
  return { min: pick(Math.min), max: pick(Math.max) };
}

/** Minimum and maximum coordinate of a box along a direction. */
export function reach({ min, max }: Bounds, normal: Vec3): readonly [number, number] {
  const sum = (pick: (a: number, b: number) => number) =>
    normal.reduce((total, n, axis) => total + pick(n * (min[axis] ?? 0), n * (max[axis] ?? 0)), 0);
  return [sum(Math.min), sum(Math.max)];
}

/** Minimum and maximum value of a field. */
export function sampleRange({ fields }: VolumeInfo, field: string | undefined): readonly [number, number] {
  const histogram = fields.find(({ name }) => name === field)?.histogram;
  return histogram === undefined ? [0, 1] : [histogram.min, histogram.max];
}

/** Share of the samples at either end that are black or white alike: metal, and single bright samples, would leave all else in the dark. */
const TAIL = 0.005;

/**
 * The range between black and white until the user sets one: a field's values without the rarest at both ends; all values if few remain.
 */
export function usualWindow(volume: VolumeInfo, field: string | undefined): readonly [number, number] {
  const whole = sampleRange(volume, field);
  const counts = volume.fields.find(({ name }) => name === field)?.histogram.counts ?? [];
  const tail = TAIL * counts.reduce((sum, n) => sum + n, 0);
  const first = binPast(counts, tail);
  const last = counts.length - 1 - binPast(counts.toReversed(), tail);
  const bin = (whole[1] - whole[0]) / counts.length;
  return last > first ? [whole[0] + first * bin, last === counts.length - 1 ? whole[1] : whole[0] + (last + 1) * bin] : whole;
}

/** What lies between black and white: the usual window of the volume's own fields; of an expression only the samples of `planes` are known. */
export function openingWindow(volume: VolumeInfo | undefined, field: string, planes: () => readonly Float32Array[]): readonly [number, number] {
  return volume?.fields.some(({ name }) => name === field) === true ? usualWindow(volume, field) : rangeOf(planes());
}

/** Minimum and maximum of the finite samples. */
function rangeOf(planes: readonly Float32Array[]): readonly [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const samples of planes) {
    for (const value of samples) {
      if (value < low && value !== -Infinity) low = value;
      if (value > high && value !== Infinity) high = value;
    }
  }
  return low < high ? [low, high] : [0, 1];
}

/** The first bin up to which there are more than `tail` samples. */
function binPast(counts: readonly number[], tail: number): number {
  let sum = 0;
  return Math.max(0, counts.findIndex((n) => (sum += n) > tail));
}
