/** What decides how much is decimated, in the units that the panel shows. Pure. */

import type { GuardName, Statistics, TriangleBudget, View } from "../../protocol/types";
import type { LengthScale } from "../../state/lengths";
import { formatCount, formatLength } from "../format";

/** An error, a budget, or β. */
export type Criterion = "error" | "triangles" | "beta";

/** A tolerance above the error by more than this factor is another one: the server computes with fewer digits. */
const IS_GREATER = 1.0001;

/** Without a camera, a pixel counts as this many smallest spacings. */
export const SPACINGS_OF_PIXEL = 0.1;

/** What decides; of an error beside a budget the one whose tolerance is in force. `spacing`: the volume's smallest one. */
export function criterion(view: View, statistics: Statistics | undefined, spacing: number): Criterion {
  const hasBudget = view.triangles !== undefined || view.bytes !== undefined;
  if (view.error === undefined) return hasBudget ? "triangles" : "beta";
  // Of a surface for a camera the server says it.
  if (hasBudget && statistics?.pixels) return statistics.pixels.limitedBy === "budget" ? "triangles" : "error";
  const error = inSpacings(view.error, spacing) * spacing;
  return hasBudget && (statistics?.tolerance ?? 0) > error * IS_GREATER ? "triangles" : "error";
}

/** A distance, which is a number of world units or text such as `0.1vx` or `1px`, as multiples of the smallest spacing. */
export function inSpacings(distance: number | string, spacing: number): number {
  const size = typeof distance === "number" ? spacing : distance.endsWith("px") ? 1 / SPACINGS_OF_PIXEL : distance.endsWith("vx") ? 1 : spacing;
  const multiples = (typeof distance === "number" ? distance : parseFloat(distance)) / size;
  return Number(multiples.toPrecision(6));
}

/** A budget as a number of triangles; `undefined` if it is a share of a full surface that is not known yet. */
export function trianglesOf(budget: TriangleBudget, fullTriangles: number | undefined): number | undefined {
  if (typeof budget === "number") return budget;
  if (fullTriangles === undefined) return budget.max;
  return Math.max(1, Math.min(Math.floor(budget.share * fullTriangles), budget.max ?? Infinity));
}

/** What a guard that gave way has let happen. */
export function gaveWayText(
  guard: GuardName,
  { error, estimatedError, vanishedParts }: Pick<Statistics, "error" | "estimatedError" | "vanishedParts">,
  scale: LengthScale,
): string {
  if (guard === "topology") {
    if (vanishedParts === null) return "Topology not kept: the budget is too small";
    return `${formatCount(vanishedParts)} small part${vanishedParts === 1 ? "" : "s"} left out: the budget is too small`;
  }
  if (error !== null) return `Max. error ${formatLength(error.max, scale)}`;
  return estimatedError === null ? "The limit on the error is not kept" : `Error ≈ ${formatLength(estimatedError.rms, scale)} (RMS)`;
}
