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
  /** From the edit to the first frame, and to that of the final surface. */
  readonly firstMs: number | undefined;
  readonly lastMs: number | undefined;
}

/** A prefix that is on screen. */
interface ShownPrefix {
  readonly generation: number;
  readonly level: number;
  /** The final surface of its generation. */
  readonly final: boolean;
}

export interface ViewerState {
  readonly connection: ConnectionState;
  /** `undefined` until the server has listed them. */
  readonly volumes: readonly VolumeSummary[] | undefined;
  /** What the user asked for last. */
  readonly target: Target | undefined;
  /** The server has not answered the last `open` yet. */
  readonly opening: boolean;
  /** How much of what that takes is done, 0 to 1; `undefined` where the server has not said so. */
  readonly openedShare: number | undefined;
  /** The open volume. */
  readonly volume: VolumeInfo | undefined;
  /** Values in force. */
  readonly view: View | undefined;
  /** Name of the server's device. */
  readonly device: string | undefined;
  /** Of the last final surface, and its generation. */
  readonly statistics: Statistics | undefined;
  readonly finished: number | undefined;
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
  | ({ readonly type: "swap" } & ShownPrefix)
  /** A frame was rendered. */
  | { readonly type: "frame"; readonly at: number };

export const INITIAL_STATE: ViewerState = {
  connection: "connecting",
  volumes: undefined,
  target: undefined,
  opening: false,
  openedShare: undefined,
  volume: undefined,
  view: undefined,
  device: undefined,
  statistics: undefined,
  finished: undefined,
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
      return { ...state, target: event.target, opening: true, openedShare: undefined };
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
      return { ...state, shown: { generation: event.generation, level: event.level, final: event.final }, frameDue: true };
    case "frame":
      return frame(state, event.at);
  }
}

function receive(state: ViewerState, message: ServerMessage): ViewerState {
  switch (message.type) {
    case "opening":
      return { ...state, openedShare: message.bytes / Math.max(1, message.totalBytes) };
    case "opened":
      return opened(state, message);
    case "prefix":
      // After a generation is done, a better surface of the same view may follow: the one on screen is finished all the same.
      return {
        ...state,
        working: state.working || message.generation !== state.finished,
        progress: progressOf(state, message.generation),
      };
    case "done":
      return { ...state, working: false, statistics: message.statistics, finished: message.generation };
    case "measured":
      return measured(state, message);
    case "error":
      return { ...state, working: false, opening: false, openedShare: undefined };
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
    openedShare: undefined,
    volume,
    view: { ...edit, transferFunction: { points: sorted(edit.transferFunction.points) } },
    device,
    progress: undefined,
    // Another step replaces the surface when it arrives, another volume at once.
    shown: sameVolume ? state.shown : undefined,
    statistics: sameVolume ? state.statistics : undefined,
    finished: undefined,
  };
}

/** The statistics get the error that was measured after them. */
function measured(state: ViewerState, { generation, error }: Extract<ServerMessage, { type: "measured" }>): ViewerState {
  if (state.statistics === undefined || state.finished !== generation) return state;
  return { ...state, statistics: { ...state.statistics, error } };
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
  const lastMs = progress.lastMs ?? (shown.final ? elapsed : undefined);
  return { ...state, frameDue: false, progress: { ...progress, firstMs, lastMs } };
}

/** The generation whose first frame lies between the two states and shows a prefix before the final surface; `undefined` where there is none. */
export function firstCoarseFrame(before: ViewerState, after: ViewerState): number | undefined {
  const { progress, shown } = after;
  if (progress?.firstMs === undefined || before.progress?.firstMs !== undefined) return undefined;
  return shown?.final === false ? progress.generation : undefined;
}

/** The final surface is on screen. */
export function showsFinal(state: ViewerState): boolean {
  return state.shown?.final === true && !state.frameDue;
}
