/** Which places of the world are behind a surface, as it is seen: their texts are fainter. Pure. */

import { Vector3, type OrthographicCamera, type PerspectiveCamera } from "three";

type Camera = PerspectiveCamera | OrthographicCamera;

/** Points along each side of the picture. */
export const ACROSS = 256;
/** A place on the surface is not behind it, though the surface is seen in points: as a share of its depth. */
const TOLERANCE = 0.01;
/** It is looked for if no frame was rendered for this time. */
export const HIDDEN_MS = 220;

/** Whether a place is behind a surface. @param depths of `ACROSS`² points, rows from below, 0 if there is no surface */
export function isBehind(place: Vector3, camera: Camera, depths: readonly number[]): boolean {
  const depth = -place.clone().applyMatrix4(camera.matrixWorldInverse).z;
  const { x, y } = place.clone().project(camera);
  const [column, row] = [x, y].map((n) => Math.floor((0.5 + 0.5 * n) * ACROSS));
  if (column === undefined || row === undefined || column < 0 || row < 0 || column >= ACROSS || row >= ACROSS) return false;
  // The farthest of what is around it: at an outline the one beside it is nearer.
  let farthest = 0;
  for (let r = Math.max(0, row - 1); r <= Math.min(ACROSS - 1, row + 1); r += 1) {
    for (let c = Math.max(0, column - 1); c <= Math.min(ACROSS - 1, column + 1); c += 1) {
      const there = depths[r * ACROSS + c] ?? 0;
      farthest = Math.max(farthest, there > 0 ? there : Infinity);
    }
  }
  return farthest < depth - TOLERANCE * Math.abs(depth);
}
