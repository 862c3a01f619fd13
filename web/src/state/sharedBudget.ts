/** What one surface has of a budget that several share. Pure. */

import { hasBudget } from "../protocol/view";
import type { Edit, Statistics, TriangleBudget, View } from "../protocol/types";
import type { ViewerState } from "./viewer";

type Counts = Pick<Statistics, "triangles" | "fullTriangles">;

function sharers({ surfaces }: ViewerState): ViewerState["surfaces"] {
  return surfaces.filter(({ view }) => hasBudget(view));
}

/** How many surfaces share the budget of the selected one; 1 if it has none. */
export function sharerCount(state: ViewerState): number {
  return state.view !== undefined && hasBudget(state.view) ? sharers(state).length : 1;
}

/** The edit that lets a budget decide: the one that is in force for other surfaces, else this one. */
export function budgetEdit(state: ViewerState, triangles: TriangleBudget): Edit {
  const shared = sharers(state)[0]?.view;
  return shared?.bytes === undefined ? { triangles: shared?.triangles ?? triangles } : { bytes: shared.bytes };
}

/** Statistics of the selected surface, with the triangles of all that share its budget, as far as they are known. */
export function sharedStatistics(state: ViewerState): Statistics | undefined {
  const { statistics } = state;
  if (statistics === undefined || sharerCount(state) < 2) return statistics;
  const known = sharers(state).flatMap(({ number }) => state.known.get(number)?.statistics ?? []);
  const sum = (of: keyof Counts) => known.reduce((total, one) => total + one[of], 0);
  const ofMeshers = known.flatMap(({ mesherTriangles }) => mesherTriangles ?? []);
  const mesherTriangles = ofMeshers.length === known.length ? ofMeshers.reduce((total, one) => total + one, 0) : null;
  return { ...statistics, triangles: sum("triangles"), fullTriangles: sum("fullTriangles"), mesherTriangles };
}

/** The view that makes the selected surface as it is when there are no others: its part of the budget is its own. */
export function aloneView(state: ViewerState): View | undefined {
  const { view, statistics } = state;
  const together = sharedStatistics(state);
  if (view === undefined || statistics === undefined || together === undefined || sharerCount(state) < 2) return view;
  const part = statistics.fullTriangles / Math.max(1, together.fullTriangles);
  const partOf = (budget: number) => Math.max(1, Math.floor(part * budget));
  if (view.bytes !== undefined) return { ...view, bytes: partOf(view.bytes) };
  const { triangles } = view;
  if (typeof triangles === "number") return { ...view, triangles: partOf(triangles) };
  return triangles?.max === undefined ? view : { ...view, triangles: { ...triangles, max: partOf(triangles.max) } };
}
