/** Counts of full surfaces. */

import type { Statistics } from "../protocol/types";

/** Triangles of the full surface, by the mesher in use if they were counted. */
export function allTriangles({ mesherTriangles, fullTriangles }: Pick<Statistics, "mesherTriangles" | "fullTriangles">): number {
  return mesherTriangles ?? fullTriangles;
}
