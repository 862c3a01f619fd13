/**
 * Grids whose samples are at uneven positions along some axes: from index space to *even coordinates*, those of the even grid with the same
 * ends. Pure.
 */

/** Even coordinates of the samples along an axis, ascending; null if it is even. */
export type UnevenAxis = readonly number[] | null;
export type Uneven = readonly [UnevenAxis, UnevenAxis, UnevenAxis];

/** The uneven axes of a volume's geometry; `undefined` if all axes are even. */
export function unevenOf({ spacing, positions }: { readonly spacing: readonly number[]; readonly positions?: readonly (readonly number[] | null)[] }): Uneven | undefined {
  if (positions === undefined) return undefined;
  const along = (axis: 0 | 1 | 2) => positions[axis]?.map((position) => position / (spacing[axis] ?? 1)) ?? null;
  return [along(0), along(1), along(2)];
}

/** The first sample of the cell around an index; `undefined` outside the grid, since distances are even there. */
function cellOf(axis: readonly number[], index: number): number | undefined {
  const last = axis.length - 1;
  return index >= 0 && index <= last ? Math.min(Math.floor(index), last - 1) : undefined;
}

/** The same for equal indices, to the bit. */
export function evenOf(axis: UnevenAxis, index: number): number {
  const low = axis === null ? undefined : cellOf(axis, index);
  if (axis === null || low === undefined) return index;
  const t = index - low;
  return (1 - t) * (axis[low] ?? 0) + t * (axis[low + 1] ?? 0);
}

/** Length of the cell around an index, in those of the even grid. */
export function stepOf(axis: UnevenAxis, index: number): number {
  const low = axis === null ? undefined : cellOf(axis, index);
  return axis === null || low === undefined ? 1 : (axis[low + 1] ?? 0) - (axis[low] ?? 0);
}

/** Half the distance of a sample's two neighbours; at an end the length of its cell. */
function stepAtSample(axis: readonly number[], sample: number): number {
  const [below, above] = [Math.max(sample - 1, 0), Math.min(sample + 1, axis.length - 1)];
  return ((axis[above] ?? 0) - (axis[below] ?? 0)) / (above - below);
}

/** Length over which the server takes the differences of samples, in cells of the even grid: that at the samples, linear between them, as gradients are along an edge. */
export function differenceStepOf(axis: UnevenAxis, index: number): number {
  const low = axis === null ? undefined : cellOf(axis, index);
  if (axis === null || low === undefined) return 1;
  const t = index - low;
  return (1 - t) * stepAtSample(axis, low) + t * stepAtSample(axis, low + 1);
}

/** Length of the largest cell along an axis, in those of the even grid. */
export function largestStep(axis: UnevenAxis): number {
  return (axis ?? []).reduce((largest, at, i) => (i === 0 ? largest : Math.max(largest, at - (axis?.[i - 1] ?? 0))), 1);
}
