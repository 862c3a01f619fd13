/** Edits of a view, and the budget that surfaces share. Pure. */

import { isEqual } from "./equal";
import type { Edit, View } from "./types";

/** What decides how fine the surface is: an edit that names one takes the place of all of them. */
const CRITERIA = ["beta", "error", "triangles", "bytes"] as const;

type Budget = Pick<View, "triangles" | "bytes">;

/** Whether a budget is in force for this surface: it has a share of the connection's budget. */
export function hasBudget({ triangles, bytes }: Budget): boolean {
  return triangles !== undefined || bytes !== undefined;
}

/** Returns the view with this budget in place of its own; unchanged if no budget is in force for it. */
export function withBudget(view: View, { triangles, bytes }: Budget): View {
  return hasBudget(view) ? { ...view, triangles, bytes } : view;
}

/** Whether an error or a budget decides and the vertex tree is cut: parts can be removed. */
export const cutsTree = (view: View): boolean => view.mesher === "dual" && view.beta === undefined;

/** Whether the surface is made for the camera: what it sees from near is finer. */
export const followsCamera = (view: View): boolean => cutsTree(view) && view.detail === "view";

/** The edit, with what it disables reset: the other criteria, and the removal of parts if the cut is one of cubes. */
export function complete(edit: Edit): Edit {
  const { beta, error, triangles, bytes } = edit;
  const decides = CRITERIA.some((name) => edit[name] !== undefined);
  const whole = decides ? { ...edit, beta, error, triangles, bytes } : edit;
  const cutsCubes = beta !== undefined || edit.mesher === "marching-cubes";
  return cutsCubes ? { minPart: 0, parts: null, ...whole } : whole;
}

/** The edit that makes `after` of `before`; empty if they are equal. */
export function difference(before: View, after: View): Edit {
  const names = Object.keys({ ...before, ...after }) as (keyof View)[];
  const differ = (name: keyof View) => !isEqual(before[name], after[name]);
  const edit = Object.fromEntries(names.filter(differ).map((name) => [name, after[name]])) as Edit;
  if (!CRITERIA.some(differ)) return edit;
  const { beta, error, triangles, bytes } = after;
  return { ...edit, beta, error, triangles, bytes };
}

export const isNothing = (edit: Edit): boolean => Object.keys(edit).length === 0;

/** Whether the edit changes colours alone, which the shader looks up: nothing leaves the browser. `before`: `undefined` for a new surface. */
export function isColorAlone(edit: Edit, before: View | undefined): boolean {
  const { transferFunction, ...rest } = edit;
  return before !== undefined && transferFunction !== undefined && isNothing(rest) && isEqual(importanceOf(before), importanceOf({ transferFunction }));
}

/** Whether both make the same surface. */
export function isSameSurface(a: View, b: View): boolean {
  const edit = difference(a, b);
  return isNothing(edit) || isColorAlone(edit, a);
}

/** Control points without their colours. */
export function importanceOf({ transferFunction }: Pick<View, "transferFunction">): readonly (readonly [number, number])[] {
  return transferFunction.points.map(({ x, importance }) => [x, importance]);
}
