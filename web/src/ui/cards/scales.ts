/** Sliders of what experts decide by. Pure. */

import type { Scale } from "../widgets/slider";

/** β on the slider: the low end is the full surface, the rest four decades up to 1. */
export const BETA_SCALE: Scale = {
  toValue: (t) => (t <= 0 ? -1 : Number((10 ** (4 * (t - 1))).toPrecision(3))),
  toPosition: (beta) => (beta < 0 ? 0 : Math.min(1, Math.max(0.001, 1 + Math.log10(Math.max(beta, 1e-9)) / 4))),
};

/** Ends of the slider of the error, in multiples of the smallest spacing. */
const ERROR_RANGE = [0.01, 4] as const;

/** The error on the slider: equal steps are equal factors. */
export const ERROR_SCALE: Scale = {
  toValue: (t) => Number((ERROR_RANGE[0] * (ERROR_RANGE[1] / ERROR_RANGE[0]) ** t).toPrecision(2)),
  toPosition: (error) =>
    Math.min(1, Math.max(0, Math.log(Math.max(error, 1e-9) / ERROR_RANGE[0]) / Math.log(ERROR_RANGE[1] / ERROR_RANGE[0]))),
};
