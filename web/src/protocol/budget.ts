/** The budget that surfaces share. Pure. */

import type { View } from "./types";

type Budget = Pick<View, "triangles" | "bytes">;

/** Whether a budget is in force for this surface: it has a share of the connection's budget. */
export function hasBudget({ triangles, bytes }: Budget): boolean {
  return triangles !== undefined || bytes !== undefined;
}

/** Returns the view with this budget in place of its own; unchanged if no budget is in force for it. */
export function withBudget(view: View, { triangles, bytes }: Budget): View {
  return hasBudget(view) ? { ...view, triangles, bytes } : view;
}
