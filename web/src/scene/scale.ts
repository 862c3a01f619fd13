/** How long things are in the picture: in perspective that depends on how far away they are. Pure. */

import type { OrthographicCamera, PerspectiveCamera } from "three";

/** How far before the camera surfaces are in the middle third of the picture; without what is beside them. */
export interface MiddleDepths {
  /** At the centre; if no surface is there, the median. `undefined`: there is no surface. */
  readonly centre: number | undefined;
  readonly nearest: number;
  readonly farthest: number;
}

/** A scale bar in an image is right to within this share over the middle third. */
const TOLERANCE = 0.05;

/** Depths of the middle of the picture. @param depths of a square grid, 0 if there is no surface */
export function middleDepths(depths: readonly number[]): MiddleDepths {
  const found = depths.filter((depth) => depth > 0).sort((a, b) => a - b);
  const centre = depths[(depths.length - 1) / 2] ?? 0;
  return { centre: centre > 0 ? centre : found[Math.floor(found.length / 2)], nearest: found[0] ?? Infinity, farthest: found.at(-1) ?? -Infinity };
}

/** World units across the height of the picture, at a depth. */
export function heightAt({ projectionMatrix: { elements } }: PerspectiveCamera | OrthographicCamera, depth: number): number {
  // The last element is 1 of an orthographic camera, 0 of a perspective one.
  return (2 * (elements[15] === 1 ? 1 : depth)) / elements[5];
}

/** The depth at which lengths are right to within `TOLERANCE` over the whole middle third; `undefined` if there is none. Any will do for an orthographic camera. */
export function commonDepth({ projectionMatrix: { elements } }: PerspectiveCamera | OrthographicCamera, { nearest, farthest }: MiddleDepths): number | undefined {
  if (elements[15] === 1) return 1;
  return (farthest - nearest) / (farthest + nearest) <= TOLERANCE ? (2 * nearest * farthest) / (nearest + farthest) : undefined;
}
