/** Sliders of what experts decide by. Pure. */

import type { Scale } from "../widgets/slider";

/** β on the slider: the low end is the full surface, the rest four decades up to 1. */
export const BETA_SCALE: Scale = {
  toValue: (t) => (t <= 0 ? -1 : Number((10 ** (4 * (t - 1))).toPrecision(3))),
  toPosition: (beta) => (beta < 0 ? 0 : Math.min(1, Math.max(0.001, 1 + Math.log10(Math.max(beta, 1e-9)) / 4))),
};

/** Equal steps are equal factors. */
const factors = (from: number, to: number): Scale => ({
  toValue: (t) => Number((from * (to / from) ** t).toPrecision(2)),
  toPosition: (value) => Math.min(1, Math.max(0, Math.log(Math.max(value, 1e-9) / from) / Math.log(to / from))),
});

/** The error on the slider, in multiples of the smallest spacing. */
export const ERROR_SCALE = factors(0.01, 4);

/** The error on the slider, in pixels. */
export const PIXEL_SCALE = factors(0.1, 10);
