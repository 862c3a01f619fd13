/** The error up to which parts are merged, in pixels of the picture, smallest spacings, or world units. Pure. */

import { readTyped, unitsOf } from "../../state/typedNumber";
import { formatValue } from "../format";
import type { Scale } from "../widgets/slider";
import { inSpacings, SPACINGS_OF_PIXEL } from "./criterion";
import { ERROR_SCALE, PIXEL_SCALE } from "./scales";

export type ErrorUnit = "px" | "vx" | "world";

export interface ErrorInUnit {
  readonly value: number;
  readonly unit: ErrorUnit;
}

/** The error that is offered first. */
export const FIRST_ERROR = "1px";

export function errorInUnit(error: number | string): ErrorInUnit {
  if (typeof error === "number") return { value: error, unit: "world" };
  const unit = (["px", "vx"] as const).find((unit) => error.endsWith(unit)) ?? "world";
  return { value: parseFloat(error), unit };
}

/** As edits have it. */
export const errorLimit = ({ value, unit }: ErrorInUnit): number | string => (unit === "world" ? value : `${value}${unit}`);

/** The same error in another unit, as it is without a camera. `spacing`: the volume's smallest one. */
export function convertedError(error: number | string, unit: ErrorUnit, spacing: number): ErrorInUnit {
  const sizes = { px: SPACINGS_OF_PIXEL, vx: 1, world: 1 / spacing };
  return { value: Number((inSpacings(error, spacing) / sizes[unit]).toPrecision(3)), unit };
}

/** Words that may follow a typed error. `length`: the unit of lengths in the world. */
const wordsOf = (length: string | undefined): Record<ErrorUnit, Record<string, number>> => ({
  px: { pixels: 1, pixel: 1, px: 1 },
  vx: { voxels: 1, voxel: 1, vx: 1 },
  world: unitsOf(length),
});

export const errorWordsOf = (length: string | undefined): Record<string, number> => Object.assign({}, ...Object.values(wordsOf(length))) as Record<string, number>;

/** An error that is typed with its unit; `undefined` if the text has no unit, or is no number. */
export function typedError(text: string, length: string | undefined): ErrorInUnit | undefined {
  for (const [unit, units] of Object.entries(wordsOf(length)) as [ErrorUnit, Record<string, number>][]) {
    const value = Object.keys(units).some((word) => text.trim().endsWith(word)) ? readTyped(text, { min: 0, units }) : undefined;
    if (typeof value === "number" && value >= 0) return { value, unit };
  }
  return undefined;
}

/** The slider for a unit. */
export function errorScale(unit: ErrorUnit, spacing: number): Scale {
  if (unit === "px") return PIXEL_SCALE;
  if (unit === "vx") return ERROR_SCALE;
  return {
    toValue: (position) => Number((ERROR_SCALE.toValue(position) * spacing).toPrecision(3)),
    toPosition: (error) => ERROR_SCALE.toPosition(error / spacing),
  };
}

/** What the error means, for readers of the screen. */
export function errorMeaning({ value, unit }: ErrorInUnit, length: string): string {
  if (unit === "px") return `${formatValue(value)} pixels of the picture`;
  return unit === "vx" ? `${formatValue(value)} times the distance between samples` : `${formatValue(value)} ${length}`;
}
