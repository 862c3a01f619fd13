/** Edits of a view. Pure. */

import type { Edit } from "../protocol/types";

/** The edit with what it puts out of force: β and the budgets replace each other. */
export function complete(edit: Edit): Edit {
  if (edit.beta !== undefined) return { ...edit, triangles: undefined, bytes: undefined };
  if (edit.triangles !== undefined) return { ...edit, beta: undefined, bytes: undefined };
  if (edit.bytes !== undefined) return { ...edit, beta: undefined, triangles: undefined };
  return edit;
}
