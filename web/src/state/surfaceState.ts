/** What the server says of one surface. Pure. */

import type { ServerMessage, Statistics, View } from "../protocol/types";
import type { Answers } from "./answers";

/** Bytes and times of the last edit, until its last frame. A generation for a camera keeps them. */
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
  /** Values in force when the last edit was sent. */
  readonly sentView: View | undefined;
  /** What the server answered about it. */
  readonly answers: Answers;
  /** Of the last final surface, and its generation. */
  readonly statistics: Statistics | undefined;
  readonly finished: number | undefined;
  /** An edit was sent and its generation is not done. */
  readonly working: boolean;
  /** The last generation that is not for a camera. */
  readonly edited: number | undefined;
  /** The newest generation when a camera was sent for which the surface is not made yet. */
  readonly cameraAfter: number | undefined;
  /** With the number of the newest generation. */
  readonly progress: Progress | undefined;
  readonly shown: ShownPrefix | undefined;
  /** By the numbers of generations that are on screen or on their way: the field whose values vertices have, `null` for none. */
  readonly madeFields: ReadonlyMap<number, View["colorField"]>;
  /** That of what is on screen; `undefined` at first. */
  readonly shownField: View["colorField"] | undefined;
  /** What the server answered the last edit or `open` instead of a surface. */
  readonly refusal: Refusal | undefined;
  /** `shown` is newer than the last frame. */
  readonly frameDue: boolean;
}

export const NEW_SURFACE: SurfaceState = {
  sentView: undefined,
  answers: {},
  statistics: undefined,
  finished: undefined,
  working: false,
  edited: undefined,
  cameraAfter: undefined,
  progress: undefined,
  shown: undefined,
  madeFields: new Map(),
  shownField: undefined,
  refusal: undefined,
  frameDue: false,
};

/** Whether the newest generation is for a camera: the values in force are those of the surface before. */
export function isForCamera({ edited, progress }: SurfaceState): boolean {
  return edited !== undefined && progress !== undefined && progress.generation !== edited;
}

/** Whether a generation for the camera that was sent last is still to come. Only cuts of the vertex tree follow cameras. */
export function awaitsCamera({ cameraAfter, refusal, statistics }: SurfaceState): boolean {
  return cameraAfter !== undefined && refusal === undefined && statistics?.isTreeCut === true && statistics.fullTriangles > 0;
}
