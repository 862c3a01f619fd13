/** The error of the surfaces on which colours show it: those that have the colours of the look. Pure. */

import type { Statistics } from "../protocol/types";
import { awaitedDistances, dueQuestions, measuredDistances, type DueQuestion } from "./answers";
import { together, type Distances } from "./distances";
import { allColoredByLook, type SurfaceList } from "./surfaceList";
import { seen, type SeenSurface, type ServerState } from "./viewer";

/** Of each of them; an empty surface has no error. */
function coloredStates(viewer: ServerState, surfaces: SurfaceList): readonly SeenSurface[] {
  const states = allColoredByLook(surfaces).map(({ number }) => seen(viewer, number));
  return states.filter(({ statistics }) => statistics?.triangles !== 0);
}

/** Of all of them together: one scale of colours is for all. `undefined` while that of some is not known. */
export function shownErrors(viewer: ServerState, surfaces: SurfaceList): Distances | undefined {
  const known = coloredStates(viewer, surfaces).map(measuredDistances);
  const all = known.filter((distances) => distances !== undefined);
  return all.length < known.length ? undefined : together(all);
}

/** What was measured of each. */
export function errorsOf(viewer: ServerState, surfaces: SurfaceList): readonly (Statistics["error"] | undefined)[] {
  return coloredStates(viewer, surfaces).map(({ statistics }) => statistics?.error);
}

/** Why they are not known; `undefined` if they are, or there is no such surface. */
export function awaitedErrors(viewer: ServerState, surfaces: SurfaceList): ReturnType<typeof awaitedDistances> {
  return coloredStates(viewer, surfaces).map(awaitedDistances).find((awaited) => awaited !== undefined);
}

/** The question for the next of them, if it is worth asking: a connection has one such question at a time. */
export function dueErrors(viewer: ServerState, surfaces: SurfaceList): readonly DueQuestion[] {
  return coloredStates(viewer, surfaces)
    .flatMap((state) => dueQuestions(state, ["annotate"]))
    .slice(0, 1);
}
