/** Rows of colours for the shader: RGBA over [0, 1]. Pure. */

import { Color, SRGBColorSpace } from "three";

/** The linear light of RGBA bytes, colours in sRGB. */
export function linearFromSrgb(bytes: Uint8Array): Float32Array<ArrayBuffer> {
  const found = Float32Array.from(bytes, (byte) => byte / 255);
  const color = new Color();
  for (let i = 0; i < found.length; i += 4) {
    color.fromArray(found, i);
    color.setRGB(color.r, color.g, color.b, SRGBColorSpace).toArray(found, i);
  }
  return found;
}

/** For each entry of `bytes` the entry of `ramp` at its alpha: two look-ups in one table. */
export function lookUp(bytes: Uint8Array, ramp: Uint8Array): Uint8Array<ArrayBuffer> {
  const last = ramp.length / 4 - 1;
  const found = new Uint8Array(bytes.length);
  for (let i = 0; i < bytes.length; i += 4) {
    const entry = Math.round(((bytes[i + 3] ?? 0) / 255) * last);
    found.set(ramp.subarray(4 * entry, 4 * entry + 4), i);
  }
  return found;
}
