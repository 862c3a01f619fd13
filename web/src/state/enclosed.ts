/** Area and volume of a surface on screen. Pure. */

/** World units, squared and cubed. */
export interface Enclosed {
  readonly area: number;
  /**
   * Of what lies at or above the isovalue, without its cavities; below 0 if the surface encloses lower values. `undefined` if it is open.
   */
  readonly volume: number | undefined;
  /** Edges with more triangles on one side than on the other: the surface ends there. */
  readonly borderEdges: number;
}

/** @param sums over all triangles; their volume has a meaning only if there is no border */
export function enclosedOf({ area, volume, borderEdges }: { readonly area: number; readonly volume: number; readonly borderEdges: number }): Enclosed {
  return { area, volume: borderEdges === 0 ? volume : undefined, borderEdges };
}
