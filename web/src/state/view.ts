/** Edits of a view. Pure. */

import type { Edit } from "../protocol/types";

/** The edit with what it puts out of force: one that names β, an error or a budget takes the place of all of them. */
export function complete(edit: Edit): Edit {
  const { beta, error, triangles, bytes } = edit;
  const decides = [beta, error, triangles, bytes].some((value) => value !== undefined);
  return decides ? { ...edit, beta, error, triangles, bytes } : edit;
}
