/** The unit of lengths in the world, one word everywhere. Pure. */

import type { VolumeInfo } from "../protocol/types";

/** A server that knows the unit names it beside the grid. */
type Measured = Pick<VolumeInfo, "geometry"> & { readonly geometry: { readonly unit?: string | null } };

/** Such as `mm`; `undefined` if the volume has no unit. */
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
  /** The smallest length of a cell in which errors are measured, world units: the smallest distance between samples, of an uneven axis the largest. */
  readonly spacing: number;
  readonly unit: string | undefined;
}

export function lengthScale(volume: Measured | undefined): LengthScale {
  const { spacing = [1], positions } = volume?.geometry ?? {};
  const largest = (along: readonly number[]) => Math.max(...along.slice(1).map((at, i) => at - (along[i] ?? 0)));
  const lengths = spacing.map((mean, axis) => (positions?.[axis] ? largest(positions[axis]) : mean));
  return { spacing: Math.min(...lengths), unit: lengthUnit(volume) };
}
