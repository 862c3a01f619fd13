/** What the server says of one surface. Pure. */

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
  /** Values in force when the last edit was sent. */
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
