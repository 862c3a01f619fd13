/**
 * Lines along which the surface of an isovalue crosses a slice. As the server's contours (`server/src/export/contours.rs`): inside is
 * `value >= iso`, edges are crossed at the linear interpolant, two opposite corners inside are separated, and a face that touches a missing
 * sample has no contour. Pure.
 */

/** By which corners of a face are inside, as bits: the sides that each segment connects. Side `i` is between corners `i` and `i + 1`. */
const SEGMENTS: readonly (readonly number[])[] = [
  [], [3, 0], [0, 1], [3, 1], [1, 2], [3, 0, 1, 2], [0, 2], [3, 2], [2, 3], [0, 2], [0, 1, 2, 3], [1, 2], [1, 3], [0, 1], [3, 0], [],
];

/** More are no outline: they fill the slice, as noise does, and take seconds to draw. */
const MAX_SEGMENTS = 200_000;

/**
 * @param samples row after row; NaN is missing
 * @returns ends of segments, four numbers each: columns and rows, from the first sample; `undefined` if there are more than 200,000
 */
export function contourOf(samples: ArrayLike<number>, [width, height]: readonly [number, number], iso: number): Float32Array | undefined {
  const found: number[] = [];
  for (let y = 0; y + 1 < height; y += 1) {
    if (found.length > 4 * MAX_SEGMENTS) return undefined;
    for (let x = 0; x + 1 < width; x += 1) {
      const at = y * width + x;
      const a = samples[at] ?? NaN;
      const b = samples[at + 1] ?? NaN;
      const c = samples[at + width + 1] ?? NaN;
      const d = samples[at + width] ?? NaN;
      const inside = (a >= iso ? 1 : 0) | (b >= iso ? 2 : 0) | (c >= iso ? 4 : 0) | (d >= iso ? 8 : 0);
      // NaN is not inside: such a face may look crossed.
      if (inside === 0 || inside === 15 || a + b + c + d !== a + b + c + d) continue;
      for (const side of SEGMENTS[inside] ?? []) {
        if (side === 0) found.push(x + (iso - a) / (b - a), y);
        else if (side === 1) found.push(x + 1, y + (iso - b) / (c - b));
        else if (side === 2) found.push(x + (iso - d) / (c - d), y + 1);
        else found.push(x, y + (iso - a) / (d - a));
      }
    }
  }
  return Float32Array.from(found);
}

/** Returns the samples; those for which another field's values do not hold are missing. */
export function maskedBy(samples: Float32Array, mask: ArrayLike<number>, holds: (value: number) => boolean): Float32Array {
  return samples.map((value, i) => (holds(mask[i] ?? NaN) ? value : NaN));
}
