/** The next state after an event. Pure. */

import type { Comparing } from "./comparing";
import { workOf, type State } from "./state";
import { limited } from "./surfaceList";
import { isOfServer, keepSurfaces, openTarget, reduceServer, type ServerEvent, type Target } from "./viewer";
import { opened, reduceWork, type UserEvent } from "./work";

export type StateEvent =
  | ServerEvent
  | UserEvent
  /** A volume or step is asked for. `leaving`: the work of the open volume is kept. */
  | { readonly type: "open"; readonly target: Target; readonly wish?: State["wish"]; readonly leaving?: State["leaving"] }
  | { readonly type: "compare"; readonly comparing: Comparing | undefined };

export function reduce(state: State, event: StateEvent): State {
  return arranged(changed(state, event));
}

function changed(state: State, event: StateEvent): State {
  if (event.type === "compare") return { ...state, comparing: event.comparing };
  if (event.type === "open") {
    const { target, wish = state.wish, leaving = state.leaving } = event;
    return { ...state, server: openTarget(state.server, target), wish, leaving };
  }
  if (!isOfServer(event)) return reduceWork(state, event);
  const server = reduceServer(state.server, event, workOf(state));
  const now = server === state.server ? state : { ...state, server };
  return event.type === "message" && event.message.type === "opened" ? opened(now, state.server.volume, event.message) : now;
}

/** Limits the surfaces to as many as the server allows, the first ones, and forgets what was known of others. */
function arranged(state: State): State {
  const { history, server } = state;
  if (history === undefined) return state;
  const { surfaces, selected } = history.current;
  const list = limited(surfaces, server.maxSurfaces);
  const known = keepSurfaces(server, list.map(({ number }) => number));
  if (list === surfaces) return known === server ? state : { ...state, server: known };
  const at = surfaces.findIndex(({ number }) => number === selected);
  const work = { ...history.current, surfaces: list, selected: (list[at] ?? list[0])?.number ?? 0 };
  return { ...state, server: known, history: { ...history, current: work } };
}
