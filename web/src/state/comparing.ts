/** Two pictures side by side: what is compared, and what the server is asked for meanwhile. Pure. */

import type { Edit, View } from "../protocol/types";
import { complete } from "../protocol/view";

/** Edits with what was before, the decimated surface with the full one, or the surface with importance and without. */
export type Compared = "edit" | "full" | "importance";

export interface Comparing {
  readonly kind: Compared;
  /** The full surface is not on screen yet. */
  readonly isWaiting: boolean;
  /** Triangles of the picture that is kept. */
  readonly kept: number;
}

const FULL: Edit = complete({ triangles: { share: 1 }, detail: "uniform" });

/** A view of as many triangles in which everything is as important. */
function withoutImportance(view: View, triangles: number): View {
  const points = view.transferFunction.points.map((point) => ({ ...point, importance: 0 }));
  return { ...view, ...complete({ triangles }), transferFunction: { points }, interest: [] };
}

/** What the server is asked for in place of values in force, which the user sees: the full surface while it is fetched, or none of the importance. */
export function askedView(view: View, comparing: Comparing | undefined): View {
  if (comparing?.kind === "importance") return withoutImportance(view, comparing.kept);
  return comparing?.isWaiting === true ? { ...view, ...FULL } : view;
}
