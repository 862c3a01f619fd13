/** From index space to the world and back, of grids with even and uneven axes. Pure. */

import { evenOf, unevenOf, type UnevenAxis } from "./uneven";

export type Triple = readonly [number, number, number];

/** The part of a volume's geometry that gives the positions of its samples. */
export interface PlacedGrid {
  readonly dims: Triple;
  /** World units between samples; along an uneven axis their mean. */
  readonly spacing: Triple;
  readonly origin: Triple;
  /** Unit vectors of the axes in the world. */
  readonly direction: readonly [Triple, Triple, Triple];
  readonly positions?: readonly (readonly number[] | null)[];
}

/** World units from the first sample of an axis to an index, which need not be whole and may be outside. */
export function alongOf(grid: PlacedGrid, axis: number, index: number): number {
  return (grid.spacing[axis] ?? 1) * evenOf(unevenOf(grid)?.[axis] ?? null, index);
}

/** The index at a distance from the first sample of an axis, world units: the inverse of `alongOf`. */
export function indexAlong(grid: PlacedGrid, axis: number, distance: number): number {
  return indexOfEven(unevenOf(grid)?.[axis] ?? null, distance / (grid.spacing[axis] ?? 1));
}

/** The index that has an even coordinate: the inverse of `evenOf`. */
export function indexOfEven(axis: UnevenAxis, even: number): number {
  if (axis === null || axis.length < 2 || even < 0 || even > (axis.at(-1) ?? 0)) return even;
  let [low, high] = [0, axis.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if ((axis[middle] ?? 0) <= even) low = middle;
    else high = middle;
  }
  const [from, to] = [axis[low] ?? 0, axis[high] ?? 0];
  return low + (even - from) / (to - from);
}

/** World position of an index. */
export function worldOf(grid: PlacedGrid, index: Triple): Triple {
  const along = index.map((at, axis) => alongOf(grid, axis, at));
  const world = (w: 0 | 1 | 2) => grid.direction.reduce((sum, direction, axis) => sum + direction[w] * (along[axis] ?? 0), grid.origin[w]);
  return [world(0), world(1), world(2)];
}

const cross = (a: Triple, b: Triple): Triple => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a: Triple, b: Triple): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Index at a world position: the inverse of `worldOf`, whatever the angles between the axes. */
export function indexAt(grid: PlacedGrid, position: Triple): Triple {
  const [x, y, z] = grid.direction;
  const away: Triple = [position[0] - grid.origin[0], position[1] - grid.origin[1], position[2] - grid.origin[2]];
  const volume = dot(x, cross(y, z));
  const along = [dot(away, cross(y, z)), dot(away, cross(z, x)), dot(away, cross(x, y))].map((n) => n / volume);
  const index = (axis: 0 | 1 | 2) => indexAlong(grid, axis, along[axis] ?? 0);
  return [index(0), index(1), index(2)];
}
