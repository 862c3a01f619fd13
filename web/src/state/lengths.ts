/** The unit of lengths in the world, one word everywhere. Pure. */

import type { VolumeInfo } from "../protocol/types";

/** A server that knows the unit names it beside the grid. */
type Measured = Pick<VolumeInfo, "geometry"> & { readonly geometry: { readonly unit?: string | null } };

/** Such as `mm`; `undefined` where nobody has said. */
export function lengthUnit(volume: Measured | undefined): string | undefined {
  const unit = volume?.geometry.unit?.trim() ?? "";
  return unit === "" ? undefined : unit;
}

/** `mm`, `mm²`, `world units³`: what stands behind a number. */
export function unitWord(unit: string | undefined, power: 1 | 2 | 3 = 1): string {
  return `${unit ?? "world units"}${{ 1: "", 2: "²", 3: "³" }[power]}`;
}

/** How lengths of a volume are said. */
export interface LengthScale {
  /** The smallest distance between samples, world units. */
  readonly spacing: number;
  readonly unit: string | undefined;
}

export function lengthScale(volume: Measured | undefined): LengthScale {
  return { spacing: Math.min(...(volume?.geometry.spacing ?? [1])), unit: lengthUnit(volume) };
}
