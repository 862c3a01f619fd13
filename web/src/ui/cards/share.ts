/** The slider of detail: a share of the full surface's triangles, equal steps are equal factors. Pure. */

import type { Statistics, TriangleBudget, View } from "../../protocol/types";
import type { Scale } from "../widgets/slider";
import { criterion, trianglesOf } from "./criterion";

/** The minimum share on the slider. */
const MIN_SHARE = 0.001;

export const SHARE_SCALE: Scale = {
  toValue: (t) => Number((MIN_SHARE ** (1 - t)).toPrecision(2)),
  toPosition: (share) => 1 - Math.log(Math.min(1, Math.max(MIN_SHARE, share))) / Math.log(MIN_SHARE),
};

export const SHARE_TICKS = [0.01, 0.05, 0.25, 1].map((share) => ({ at: SHARE_SCALE.toPosition(share), text: `${100 * share} %` }));

/** The share that the view asks for, or, if an error or β decides, the one that it has; `undefined` if nothing is known yet. */
export function shareOf(view: View, statistics: Statistics | undefined, spacing: number): number | undefined {
  const full = statistics?.fullTriangles ?? 0;
  if (view.triangles !== undefined && criterion(view, statistics, spacing) === "triangles") {
    if (typeof view.triangles === "object") {
      const { share, max } = view.triangles;
      return full > 0 ? Math.min(share, (max ?? Infinity) / full) : share;
    }
    return full > 0 ? Math.min(1, view.triangles / full) : undefined;
  }
  return statistics !== undefined && full > 0 ? Math.min(1, statistics.triangles / full) : undefined;
}

/** The budget for a share. A limit that the view has stays. */
export function budgetOf(share: number, view: View): TriangleBudget {
  const max = typeof view.triangles === "object" ? view.triangles.max : undefined;
  return { share, ...(max === undefined ? {} : { max }) };
}

/** Triangles in the field beside the slider: the budget if it decides, else those there are. */
export function trianglesShown(view: View, statistics: Statistics | undefined, spacing: number): number {
  const { triangles } = view;
  const decides = criterion(view, statistics, spacing) === "triangles";
  const budget = decides && triangles !== undefined ? trianglesOf(triangles, statistics?.fullTriangles) : undefined;
  return budget ?? statistics?.triangles ?? NaN;
}
