/** The error of the surface on which colours show it: the one that has the colours of the look. Pure. */

import { awaitedDistances, dueQuestions, measuredDistances, type DueQuestion } from "./answers";
import type { Distances } from "./distances";
import { coloredByLook, type SurfaceList } from "./surfaceList";
import { selectSurface } from "./surfaceState";
import type { ViewerState } from "./viewer";

function coloredState(viewer: ViewerState, surfaces: SurfaceList): ViewerState | undefined {
  const colored = coloredByLook(surfaces, viewer.selected);
  return colored && selectSurface(viewer, colored.number);
}

/** `undefined` while they are not known. */
export function shownErrors(viewer: ViewerState, surfaces: SurfaceList): Distances | undefined {
  const state = coloredState(viewer, surfaces);
  return state && measuredDistances(state);
}

/** Why they are not known; `undefined` where they are, or there is no such surface. */
export function awaitedErrors(viewer: ViewerState, surfaces: SurfaceList): ReturnType<typeof awaitedDistances> {
  const state = coloredState(viewer, surfaces);
  return state && awaitedDistances(state);
}

/** The question for them, where it is worth asking. */
export function dueErrors(viewer: ViewerState, surfaces: SurfaceList): readonly DueQuestion[] {
  const state = coloredState(viewer, surfaces);
  return state === undefined ? [] : dueQuestions(state, ["annotate"]);
}
