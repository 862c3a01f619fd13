/** What the user does to the open volume and the page, as events. Pure. */

import type { Edit, ServerMessage, View, VolumeInfo } from "../protocol/types";
import { sorted } from "../transfer/model";
import { ofItsField } from "./fields";
import { amend, cancelGesture, drag, endGesture, push, redo, startHistory, undo, type History } from "./history";
import type { Look } from "./look";
import type { PageLayers } from "./page";
import { PARTS_GESTURE, placesOf } from "./parts";
import { FIRST_SLICING, planesAt, type Slicing } from "./slicing";
import { openingLookOf, surfaceOf, workOf, type State, type Wish, type Work } from "./state";
import { added, besides, DEFAULT_STYLE, edited, listOf, removed, styled, type SurfaceList, type SurfaceStyle } from "./surfaceList";

/** What belongs to one `gesture` (a slider being dragged) is one step of the history until `end-gesture`. */
interface Gesture {
  readonly gesture?: string | undefined;
}

export type UserEvent =
  /** Of the selected surface. */
  | ({ readonly type: "edit"; readonly edit: Edit } & Gesture)
  | ({ readonly type: "look"; readonly look: Partial<Look> } & Gesture)
  | ({ readonly type: "style"; readonly surface: number; readonly style: Partial<SurfaceStyle> } & Gesture)
  /** To another time step. */
  | ({ readonly type: "step"; readonly step: number } & Gesture)
  /** A surface at another isovalue, else like the selected one; it is selected then. */
  | { readonly type: "add"; readonly iso: number }
  /** Several surfaces at once, as one step. */
  | { readonly type: "arrange"; readonly surfaces: SurfaceList }
  /** The last one stays. */
  | { readonly type: "remove"; readonly surface: number }
  /** Edits are of this surface from now on. */
  | { readonly type: "select"; readonly surface: number }
  /** All of it at once, as one step: what a link asks for. */
  | { readonly type: "replace"; readonly wish: Omit<Wish, "pose"> }
  /** What the one in control shows, in place of what is shown: no step of the history. Without `slicing` the slices stay. */
  | { readonly type: "adopt"; readonly work: Work; readonly slicing: Slicing | undefined }
  | { readonly type: "end-gesture" }
  /** As before the gesture of this name, if it is under way. */
  | { readonly type: "cancel-gesture"; readonly name: string }
  | { readonly type: "undo" }
  | { readonly type: "redo" }
  | { readonly type: "page"; readonly layers: Partial<PageLayers> };

export function reduceWork(state: State, event: UserEvent): State {
  if (event.type === "page") return changePage(state, event.layers);
  if (event.type === "replace") return replace(state, event.wish);
  if (event.type === "select") return select(state, event.surface);
  const { history, page } = state;
  if (history === undefined) return state;
  const next = nextHistory(state, history, event);
  if (event.type === "adopt") return { ...state, history: next, page: { ...page, slicing: event.slicing ?? page.slicing } };
  return next === history ? state : { ...state, history: next };
}

function nextHistory(state: State, history: History<Work>, event: Exclude<UserEvent, { readonly type: "page" | "replace" | "select" }>): History<Work> {
  switch (event.type) {
    case "adopt":
      return amend(endGesture(history), event.work);
    case "end-gesture":
      return endGesture(history);
    case "cancel-gesture":
      return cancelGesture(history, event.name);
    case "undo":
      return undo(history);
    case "redo":
      return redo(history);
    case "edit":
    case "look":
    case "style":
    case "step":
    case "add":
    case "arrange":
    case "remove": {
      const changed = changedWork(state, history.current, event);
      if (changed === history.current) return history;
      const gesture = "gesture" in event ? event.gesture : undefined;
      return gesture === undefined ? push(history, changed) : drag(history, changed, gesture);
    }
  }
}

type WorkEvent = Extract<UserEvent, { readonly type: "edit" | "look" | "style" | "step" | "add" | "arrange" | "remove" }>;

/** The work after a change; the same object if nothing changes. */
function changedWork(state: State, work: Work, event: WorkEvent): Work {
  const { surfaces, selected, look } = work;
  switch (event.type) {
    case "edit": {
      const { edit } = event;
      const view = surfaceOf(state)?.view;
      const { feature = view?.feature, colorField = view?.colorField } = edit;
      // A range of colours is one of the field's values.
      const isOther = (colorField ?? feature) !== (view?.colorField ?? view?.feature) && look.colorRange !== undefined;
      return { ...work, surfaces: edited(surfaces, selected, edit), look: isOther ? { ...look, colorRange: undefined } : look };
    }
    case "look":
      return { ...work, look: { ...look, ...event.look } };
    case "style":
      return { ...work, surfaces: styled(surfaces, event.surface, event.style) };
    case "step":
      return event.step === work.step ? work : { ...work, step: event.step };
    case "add": {
      const like = surfaceOf(state);
      if (like === undefined || surfaces.length >= state.server.maxSurfaces) return work;
      const all = added(surfaces, like, event.iso);
      return { ...work, surfaces: all, selected: all.at(-1)?.number ?? 0 };
    }
    case "arrange":
      return { ...work, surfaces: event.surfaces };
    case "remove":
      if (surfaces.length < 2) return work;
      return { ...work, surfaces: removed(surfaces, event.surface), selected: selected === event.surface ? besides(surfaces, event.surface) : selected };
  }
}

/** A volume was opened. Another one than before begins with its own work, that of a link, or what is remembered of it. */
export function opened(state: State, before: VolumeInfo | undefined, message: Extract<ServerMessage, { type: "opened" }>): State {
  const { volume, edit } = message;
  const wish = state.wish?.volume === volume.id ? state.wish : undefined;
  if (before?.id === volume.id) return { ...state, wish: undefined, leaving: undefined };
  const now = leave(state, before?.id);
  const kept = now.remembered.get(volume.id);
  const view = { ...edit, transferFunction: { points: sorted(edit.transferFunction.points) } };
  const step = state.server.target?.step ?? 0;
  const { page } = now;
  const slicing = wish === undefined ? { ...page.slicing, field: undefined, at: kept?.crosshair } : (wish.slicing ?? FIRST_SLICING);
  const wished = wish && workOfWish({ ...state, history: undefined }, wish, view);
  const first: Work = wished ?? { surfaces: [{ number: 0, view, style: DEFAULT_STYLE }], selected: 0, look: openingLookOf(state), step };
  const history = kept === undefined ? startHistory(first) : wished === undefined ? kept.history : push(kept.history, wished);
  return {
    ...now,
    wish: undefined,
    leaving: undefined,
    opening: view,
    history: amendWork(history, { step }),
    // A radius and places of another world.
    page: { ...page, brush: undefined, picked: [], kept: [], player: { ...page.player, playing: false }, slicing, story: wish?.story ?? page.story },
  };
}

/** Keeps the work of the volume that was open before, if this page has left it. */
function leave(state: State, volume: string | undefined): State {
  const { history, page, remembered } = hideOthers(state);
  if (state.leaving === undefined || volume === undefined || history === undefined) return state;
  const kept = { history: endGesture(history), pose: state.leaving.pose, crosshair: page.slicing.at };
  return { ...state, remembered: new Map([...remembered]).set(volume, kept) };
}

function workOfWish(state: State, { surfaces, selected, look, step }: Omit<Wish, "pose">, opening: View): Work {
  const list = listOf(
    opening,
    surfaces.map(({ edit, style }) => ({ edit: ofItsField(edit, opening, state.server.volume), style })),
  );
  return { surfaces: list, selected: list[selected]?.number ?? 0, look: { ...openingLookOf(state), ...look }, step: step ?? workOf(state).step };
}

function replace(state: State, wish: Omit<Wish, "pose">): State {
  if (state.opening === undefined) return state;
  const now = changePage(state, { slicing: wish.slicing ?? FIRST_SLICING, story: wish.story ?? state.page.story });
  return now.history === undefined ? now : { ...now, history: push(now.history, workOfWish(now, wish, state.opening)) };
}

function select(state: State, surface: number): State {
  if (workOf(state).surfaces.every(({ number }) => number !== surface)) return state;
  const now = hideOthers(state);
  return { ...now, history: now.history && amendWork(endGesture(now.history), { selected: surface }) };
}

function changePage(state: State, layers: Partial<PageLayers>): State {
  // What was begun with a tool ends with it.
  const isOther = "tool" in layers && layers.tool !== state.page.tool;
  const now = leavePlanes(isOther ? hideOthers(state) : state, layers);
  const changed = { ...now, page: { ...now.page, ...(isOther ? { picked: [] } : {}), ...layers } };
  return isOther && layers.tool === "keep-another" ? showOthers(changed) : changed;
}

/** Slices in the picture stay at the last place of the crosshair. */
function leavePlanes(state: State, layers: Partial<PageLayers>): State {
  const { history, page: { slicing }, server: { volume } } = state;
  if (layers.slicing?.layout !== "picture" || slicing.layout === "picture" || history === undefined || volume === undefined) return state;
  const { look } = history.current;
  const planes = planesAt(look.slices.planes, slicing, volume.geometry.dims);
  return { ...state, history: amendWork(history, { look: { ...look, slices: { ...look.slices, planes } } }) };
}

/** All parts are shown beside those that are kept, until one of them is chosen or the tool is put down. */
function showOthers(state: State): State {
  const kept = placesOf(surfaceOf(state)?.view.parts ?? null);
  return reduceWork({ ...state, page: { ...state.page, kept } }, { type: "edit", edit: { parts: null }, gesture: PARTS_GESTURE });
}

/** None was chosen: as before. */
function hideOthers(state: State): State {
  if (state.page.kept.length === 0) return state;
  return { ...state, history: state.history && cancelGesture(state.history, PARTS_GESTURE), page: { ...state.page, kept: [] } };
}

const amendWork = (history: History<Work>, change: Partial<Work>): History<Work> => amend(history, { ...history.current, ...change });
