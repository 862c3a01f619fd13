/** Tests which places of the world are behind a surface as seen: their texts are fainter. Pure. */

import { Vector3, type OrthographicCamera, type PerspectiveCamera } from "three";

type Camera = PerspectiveCamera | OrthographicCamera;

/** Points along each side of the picture. */
export const ACROSS = 256;
/** Tolerance as a share of the depth, so that a place on the surface does not count as behind it, although the surface is sampled. */
const TOLERANCE = 0.01;
/** Time without a rendered frame after which places are tested. */
export const HIDDEN_MS = 220;

/** Whether a place is behind a surface. @param depths of `ACROSS`² points, rows from below, 0 if there is no surface */
export function isBehind(place: Vector3, camera: Camera, depths: readonly number[]): boolean {
  const depth = -place.clone().applyMatrix4(camera.matrixWorldInverse).z;
  const { x, y } = place.clone().project(camera);
  const [column, row] = [x, y].map((n) => Math.floor((0.5 + 0.5 * n) * ACROSS));
  if (column === undefined || row === undefined || column < 0 || row < 0 || column >= ACROSS || row >= ACROSS) return false;
  // The farthest of the surrounding points: at an outline, the one beside it is nearer.
  let farthest = 0;
  for (let r = Math.max(0, row - 1); r <= Math.min(ACROSS - 1, row + 1); r += 1) {
    for (let c = Math.max(0, column - 1); c <= Math.min(ACROSS - 1, column + 1); c += 1) {
      const there = depths[r * ACROSS + c] ?? 0;
      farthest = Math.max(farthest, there > 0 ? there : Infinity);
    }
  }
  return farthest < depth - TOLERANCE * Math.abs(depth);
}
