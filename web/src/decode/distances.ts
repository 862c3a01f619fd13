/** Reads a chunk of kind `error`: the distance of each vertex of a region to the isosurface. Pure. */

import { ChunkError, HEADER_BYTES, type ChunkHeader } from "../protocol/chunk";

/** Distance of a vertex without an isosurface near it: a number that a shader can interpolate, unlike infinity. */
export const FAR_AWAY = 1e30;

/**
 * World units, in the order of the region's vertices.
 * @param frame whose header was read and checked
 * @throws ChunkError when one of them is no distance
 */
export function readDistances({ region }: ChunkHeader, frame: ArrayBuffer): Float32Array<ArrayBuffer> {
  const distances = new Float32Array(frame.slice(HEADER_BYTES));
  distances.forEach((distance, vertex) => {
    if (!(distance >= 0)) {
      throw new ChunkError(`mesh chunk of region (${region.join(", ")}): distance ${distance} of vertex ${vertex}, expected 0 or more`);
    }
    distances[vertex] = Math.min(distance, FAR_AWAY);
  });
  return distances;
}
