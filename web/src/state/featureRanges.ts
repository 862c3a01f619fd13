/** The range of a feature that the server has chosen, because the view names none. Pure. */

import type { View } from "../protocol/types";
import type { Surface, SurfaceList } from "./surfaceList";
import type { ServerState } from "./viewer";

/** The view with the range that is in force, if it is known. */
export function withRange({ known }: Pick<ServerState, "known">, { number, view }: Pick<Surface, "number" | "view">): View {
  const range = view.featureRange ?? known.get(number)?.statistics?.featureRange;
  return range === view.featureRange || range === null || range === undefined ? view : { ...view, featureRange: range };
}

export function withRanges(viewer: Pick<ServerState, "known">, surfaces: SurfaceList): SurfaceList {
  return surfaces.map((surface) => ({ ...surface, view: withRange(viewer, surface) }));
}
