/** Edits of a view. Pure. */

import type { Edit, View } from "../protocol/types";

/** What decides how fine the surface is: an edit that names one takes the place of all of them. */
const CRITERIA = ["beta", "error", "triangles", "bytes"] as const;

/** Whether an error or a budget decides and the vertex tree is cut: parts can be removed. */
export const cutsTree = (view: View): boolean => view.mesher === "dual" && view.beta === undefined;

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
  const differ = (name: keyof View) => JSON.stringify(before[name]) !== JSON.stringify(after[name]);
  const edit = Object.fromEntries(names.filter(differ).map((name) => [name, after[name]])) as Edit;
  if (!CRITERIA.some(differ)) return edit;
  const { beta, error, triangles, bytes } = after;
  return { ...edit, beta, error, triangles, bytes };
}
