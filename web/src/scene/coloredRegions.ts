/** Regions of the world with a colour of their own, which is shown if their importance exceeds that of the surface. */

import { ClampToEdgeWrapping, DataTexture, FloatType, NearestFilter, RGBAFormat } from "three";
import { linearFromSrgb } from "./colorTable";
import type { Vec3 } from "./world";

export interface ColoredRegion {
  /** A ball, or a box along the axes of the world. */
  readonly ball?: { readonly center: Vec3; readonly radius: number } | undefined;
  readonly box?: { readonly min: Vec3; readonly max: Vec3 } | undefined;
  readonly importance: number;
  /** Red, green and blue, 0 to 255. */
  readonly color: readonly [number, number, number];
}

const ROWS = 3;

/** A column for each region: its centre and radius, or its low corner and 0; its high corner, and how important it is; its colour as light. */
export function regionTexture(regions: readonly ColoredRegion[]): DataTexture {
  const width = Math.max(1, regions.length);
  const texels = new Float32Array(4 * width * ROWS);
  regions.forEach(({ ball, box, importance, color }, column) => {
    texels.set([...(ball?.center ?? box?.min ?? [0, 0, 0]), ball?.radius ?? 0], 4 * column);
    texels.set([...(box?.max ?? [0, 0, 0]), importance], 4 * (width + column));
    texels.set(linearFromSrgb(Uint8Array.from([...color, 255])), 4 * (2 * width + column));
  });
  const texture = new DataTexture(texels, width, ROWS, RGBAFormat, FloatType, undefined, ClampToEdgeWrapping, ClampToEdgeWrapping, NearestFilter, NearestFilter);
  texture.needsUpdate = true;
  return texture;
}
