/** Lookup tables for the shader: RGBA bytes over [0, 1], colour in sRGB. Pure. */

import { evaluate, type Points } from "./model";

/** Entries of a table: steps of a transfer function are resolved to a thousandth. */
const LUT_SIZE = 1024;

/** Colour in RGB, importance in A. */
export function transferLut(points: Points, size = LUT_SIZE): Uint8Array<ArrayBuffer> {
  const lut = new Uint8Array(4 * size);
  for (let i = 0; i < size; i += 1) {
    const { color, importance } = evaluate(points, i / (size - 1));
    lut.set([color.r + 0.5, color.g + 0.5, color.b + 0.5, importance * 255 + 0.5], 4 * i);
  }
  return lut;
}

/** Colours of importance, from low to high: dark blue over teal and sand to white, uniform in lightness. */
export const IMPORTANCE_STOPS = ["#1b2a49", "#23517a", "#2a7f93", "#5aa88c", "#a9c77f", "#ecdf9a", "#fffbea"] as const;

/** Equidistant colours, interpolated linearly. */
export function rampLut(stops: readonly string[], size = 256): Uint8Array<ArrayBuffer> {
  const points = stops.map((color, i) => ({ x: i / (stops.length - 1), importance: 0, color }));
  const lut = transferLut(points, size);
  for (let i = 3; i < lut.length; i += 4) lut[i] = 255;
  return lut;
}

/** Colours of levels 0 (finest) to 5: warm for fine, cool for coarse; distinct for colour-blind users too. */
export const LEVEL_COLORS = ["#d9532c", "#eb9f2f", "#f1dd5c", "#3fae83", "#4f9bd9", "#8a6fc4"] as const;
