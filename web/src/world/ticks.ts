/** Round numbers along a length. Pure. */

/** The largest of 1, 2 and 5 times a power of ten that is not above `value`, which is positive. */
export function roundBelow(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  const share = value / power;
  // A little slack: 0.3 / 0.1 is less than 3.
  const digit = share >= 5 - 1e-9 ? 5 : share >= 2 - 1e-9 ? 2 : 1;
  return digit * power;
}

/** Round numbers between two others, at most `max` of them, and at least one step of them if there is space. */
export function ticks(low: number, high: number, max: number): number[] {
  const range = high - low;
  if (!(range > 0) || !Number.isFinite(range)) return [];
  let step = roundBelow(range / max);
  while (range / step > max) step = roundBelow(step * 2.5);
  const found: number[] = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * range; i += 1) found.push(i * step);
  return found;
}

/** A tick's number, with the decimals that steps of this size need. */
export function tickText(value: number, step: number): string {
  const size = Math.max(Math.abs(value), step);
  if (size >= 1e6 || (step < 1e-4 && size > 0)) return value === 0 ? "0" : value.toPrecision(3).replace(/\.?0+(e|$)/, "$1");
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return (Object.is(value, -0) || Math.abs(value) < step * 1e-6 ? 0 : value).toFixed(decimals).replace("-", "−");
}

/** A bar of a round length that takes at most `max` pixels. */
export function scaleBar(unitsPerPixel: number, max: number): { readonly length: number; readonly pixels: number } {
  const length = roundBelow(unitsPerPixel * max);
  return { length, pixels: length / unitsPerPixel };
}
