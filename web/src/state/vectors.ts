/** Vectors of three numbers. Pure. */

import type { Vec3 } from "../protocol/types";

export const minus = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const lengthOf = (v: Vec3): number => Math.hypot(...v);
