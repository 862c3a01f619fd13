/** What the viewer knows of each surface: the selected one's is at hand, and that of the others beside it. Pure. */

import type { ServerMessage, Statistics, View } from "../protocol/types";
import type { Answers } from "./answers";

/** Bytes and times of one generation, from the edit that caused it to its last frame. */
export interface Progress {
  readonly generation: number;
  /** When the edit was sent, by `performance.now()`. */
  readonly startedAt: number;
  readonly bytes: number;
  /** From the edit to the first frame, and to that of the final surface. */
  readonly firstMs: number | undefined;
  readonly lastMs: number | undefined;
}

/** A prefix that is on screen. */
export interface ShownPrefix {
  readonly generation: number;
  readonly level: number;
  /** The final surface of its generation. */
  readonly final: boolean;
}

/** Why there is no surface for the values in force. */
type Refusal = Extract<ServerMessage, { readonly type: "error" }>;

/** What is known of one surface. */
export interface SurfaceState {
  /** Values in force. */
  readonly view: View | undefined;
  /** Values of the last edit that was sent. */
  readonly sentView: View | undefined;
  /** What the server answered about it. */
  readonly answers: Answers;
  /** Of the last final surface, and its generation. */
  readonly statistics: Statistics | undefined;
  readonly finished: number | undefined;
  /** An edit was sent and its generation is not done. */
  readonly working: boolean;
  /** Of the newest generation. */
  readonly progress: Progress | undefined;
  readonly shown: ShownPrefix | undefined;
  /** What the server answered the last edit or `open` instead of a surface. */
  readonly refusal: Refusal | undefined;
  /** `shown` is newer than the last frame. */
  readonly frameDue: boolean;
}

export const NEW_SURFACE: SurfaceState = {
  view: undefined,
  sentView: undefined,
  answers: {},
  statistics: undefined,
  finished: undefined,
  working: false,
  progress: undefined,
  shown: undefined,
  refusal: undefined,
  frameDue: false,
};

/** A state that has that of its selected surface among its own fields. */
interface Surfaces extends SurfaceState {
  readonly selected: number;
  /** Without the selected one, by their numbers. */
  readonly others: ReadonlyMap<number, SurfaceState>;
}

function ofSelected(state: SurfaceState): SurfaceState {
  const { view, sentView, answers, statistics, finished, working, progress, shown, refusal, frameDue } = state;
  return { view, sentView, answers, statistics, finished, working, progress, shown, refusal, frameDue };
}

/** All surfaces by their numbers, which ascend. */
export function surfacesOf(state: Surfaces): ReadonlyMap<number, SurfaceState> {
  const all: [number, SurfaceState][] = [...state.others, [state.selected, ofSelected(state)]];
  return new Map(all.sort(([a], [b]) => a - b));
}

/** The state with another surface selected; unchanged if there is no surface of that number. */
export function selectSurface<T extends Surfaces>(state: T, selected: number): T {
  const there = state.others.get(selected);
  if (there === undefined) return state;
  const others = new Map([...state.others, [state.selected, ofSelected(state)] as const]);
  others.delete(selected);
  return { ...state, ...there, selected, others };
}

/** Changes one surface, whichever is selected. What comes of one that was removed changes nothing. */
export function inSurface<T extends Surfaces>(state: T, number: number, change: (state: T) => T): T {
  if (number === state.selected) return change(state);
  if (!state.others.has(number)) return state;
  return selectSurface(change(selectSurface(state, number)), state.selected);
}

/** Changes each surface. */
export function everySurface<T extends Surfaces>(state: T, change: (state: T) => T): T {
  return [...surfacesOf(state).keys()].reduce((all, number) => inSurface(all, number, change), state);
}
