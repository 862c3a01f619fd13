/** What the viewer knows of the server, the open volume and the surface on screen. Pure: `reduce` alone makes a new state. */

import type { ConnectionState } from "../net/connection";
import type { Edit, ServerMessage, Statistics, View, VolumeInfo, VolumeSummary } from "../protocol/types";
import { sorted } from "../transfer/model";

/** A volume at a time step. */
interface Target {
  readonly volume: string;
  readonly step: number;
}

/** Bytes and times of one generation, from the edit that caused it to its last frame. */
interface Progress {
  readonly generation: number;
  /** When the edit was sent, by `performance.now()`. */
  readonly startedAt: number;
  readonly bytes: number;
  /** From the edit to the first frame, and to the frame of level 0. */
  readonly firstMs: number | undefined;
  readonly lastMs: number | undefined;
}

/** A prefix that is on screen. */
interface ShownPrefix {
  readonly generation: number;
  readonly level: number;
}

export interface ViewerState {
  readonly connection: ConnectionState;
  /** `undefined` until the server has listed them. */
  readonly volumes: readonly VolumeSummary[] | undefined;
  /** What the user asked for last. */
  readonly target: Target | undefined;
  /** The server has not answered the last `open` yet. */
  readonly opening: boolean;
  /** The open volume. */
  readonly volume: VolumeInfo | undefined;
  /** Values in force. */
  readonly view: View | undefined;
  /** Name of the server's device. */
  readonly device: string | undefined;
  /** Of the last finished generation. */
  readonly statistics: Statistics | undefined;
  /** When the last edit was sent, by `performance.now()`. */
  readonly editSentAt: number;
  /** An edit was sent and its generation is not done. */
  readonly working: boolean;
  /** Of the newest generation. */
  readonly progress: Progress | undefined;
  readonly shown: ShownPrefix | undefined;
  /** `shown` is newer than the last frame. */
  readonly frameDue: boolean;
  /** Mesh bytes since the page was opened. */
  readonly bytesReceived: number;
}

export type ViewerEvent =
  | { readonly type: "connection"; readonly state: ConnectionState }
  | { readonly type: "volumes"; readonly volumes: readonly VolumeSummary[] }
  /** The user asked for a volume or step. */
  | { readonly type: "open"; readonly target: Target }
  /** The user changed the view. */
  | { readonly type: "edit"; readonly edit: Edit }
  /** An edit was sent. */
  | { readonly type: "sent"; readonly at: number }
  | { readonly type: "message"; readonly message: ServerMessage }
  | { readonly type: "chunk"; readonly bytes: number }
  /** The scene shows a prefix from the next frame on. */
  | { readonly type: "swap"; readonly generation: number; readonly level: number }
  /** A frame was rendered. */
  | { readonly type: "frame"; readonly at: number };

export const INITIAL_STATE: ViewerState = {
  connection: "connecting",
  volumes: undefined,
  target: undefined,
  opening: false,
  volume: undefined,
  view: undefined,
  device: undefined,
  statistics: undefined,
  editSentAt: 0,
  working: false,
  progress: undefined,
  shown: undefined,
  frameDue: false,
  bytesReceived: 0,
};

export function reduce(state: ViewerState, event: ViewerEvent): ViewerState {
  switch (event.type) {
    case "connection":
      return { ...state, connection: event.state, working: event.state === "connected" && state.working };
    case "volumes":
      return { ...state, volumes: event.volumes };
    case "open":
      return { ...state, target: event.target, opening: true };
    case "edit":
      return state.view === undefined ? state : { ...state, view: { ...state.view, ...event.edit } };
    case "sent":
      return { ...state, editSentAt: event.at, working: true };
    case "message":
      return receive(state, event.message);
    case "chunk":
      return {
        ...state,
        bytesReceived: state.bytesReceived + event.bytes,
        progress: state.progress && { ...state.progress, bytes: state.progress.bytes + event.bytes },
      };
    case "swap":
      return { ...state, shown: { generation: event.generation, level: event.level }, frameDue: true };
    case "frame":
      return frame(state, event.at);
  }
}

function receive(state: ViewerState, message: ServerMessage): ViewerState {
  switch (message.type) {
    case "opened":
      return opened(state, message);
    case "prefix":
      return { ...state, working: true, progress: progressOf(state, message.generation) };
    case "done":
      return { ...state, working: false, statistics: message.statistics };
    case "error":
      return { ...state, working: false, opening: false };
    case "committed":
    case "superseded":
      return state;
  }
}

function opened(state: ViewerState, { volume, edit, device }: Extract<ServerMessage, { type: "opened" }>): ViewerState {
  const sameVolume = state.volume?.id === volume.id;
  return {
    ...state,
    opening: false,
    volume,
    view: { ...edit, transferFunction: { points: sorted(edit.transferFunction.points) } },
    device,
    progress: undefined,
    // Another step replaces the surface when it arrives, another volume at once.
    shown: sameVolume ? state.shown : undefined,
    statistics: sameVolume ? state.statistics : undefined,
  };
}

function progressOf(state: ViewerState, generation: number): Progress {
  if (state.progress?.generation === generation) return state.progress;
  return { generation, startedAt: state.editSentAt, bytes: 0, firstMs: undefined, lastMs: undefined };
}

function frame(state: ViewerState, at: number): ViewerState {
  const { progress, shown, frameDue } = state;
  if (!frameDue) return state;
  if (progress === undefined || progress.generation !== shown?.generation) return { ...state, frameDue: false };
  const elapsed = at - progress.startedAt;
  const firstMs = progress.firstMs ?? elapsed;
  const lastMs = progress.lastMs ?? (shown.level === 0 ? elapsed : undefined);
  return { ...state, frameDue: false, progress: { ...progress, firstMs, lastMs } };
}

/** The generation whose first frame lies between the two states and shows a coarse prefix; `undefined` where there is none. */
export function firstCoarseFrame(before: ViewerState, after: ViewerState): number | undefined {
  const { progress, shown } = after;
  if (progress?.firstMs === undefined || before.progress?.firstMs !== undefined) return undefined;
  return (shown?.level ?? 0) > 0 ? progress.generation : undefined;
}

/** The final surface is on screen. */
export function showsFinal(state: ViewerState): boolean {
  return state.shown?.level === 0 && !state.frameDue;
}
