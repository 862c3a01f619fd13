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

/** Colour of the blended value itself or of its importance in place of that of the points. */
export function mappedLut(points: Points, stops: readonly string[], by: "feature" | "importance"): Uint8Array<ArrayBuffer> {
  const lut = transferLut(points);
  const last = lut.length / 4 - 1;
  const ramp = rampLut(stops, lut.length / 4);
  for (let i = 0; i <= last; i += 1) {
    const at = by === "feature" ? i : Math.round(((lut[4 * i + 3] ?? 0) / 255) * last);
    lut.set(ramp.subarray(4 * at, 4 * at + 3), 4 * i);
  }
  return lut;
}

/** Equidistant colours, interpolated linearly. */
export function rampLut(stops: readonly string[], size = 256): Uint8Array<ArrayBuffer> {
  const points = stops.map((color, i) => ({ x: i / (stops.length - 1), importance: 0, color }));
  const lut = transferLut(points, size);
  for (let i = 3; i < lut.length; i += 4) lut[i] = 255;
  return lut;
}

/** Colours of levels 0 (finest) to 5: warm for fine, cool for coarse, and apart for colour-blind eyes (test/vision.ts simulates them). */
export const LEVEL_COLORS = ["#a3260f", "#ea7d2c", "#f7e07a", "#2b9a84", "#79bdf0", "#4a3f9f"] as const;
