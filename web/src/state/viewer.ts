/** What the viewer knows of the server, the open volume and its surfaces on screen. Pure: `reduce` alone makes a new state. */

import type { ConnectionState } from "../net/connection";
import type { Capabilities, Preparation, ServerMessage, View, VolumeInfo, VolumeSummary } from "../protocol/types";
import { sorted } from "../transfer/model";
import { isAboutQuestion, outdated, take, takeDistances } from "./answers";
import type { Distances } from "./distances";
import { everySurface, inSurface, NEW_SURFACE, surfacesOf, type Progress, type ShownPrefix, type SurfaceState } from "./surfaceState";

/** A volume at a time step. */
interface Target {
  readonly volume: string;
  readonly step: number;
}

export interface ViewerState extends SurfaceState {
  readonly connection: ConnectionState;
  /** `undefined` until the server has listed them. */
  readonly volumes: readonly VolumeSummary[] | undefined;
  /** What the user asked for last. */
  readonly target: Target | undefined;
  /** The server has not answered the last `open` yet. */
  readonly opening: boolean;
  /** How much of what that takes is done, 0 to 1; `undefined` if the server has not said so. */
  readonly openedShare: number | undefined;
  /** Steps that come before it, while the server prepares its device. */
  readonly preparing: Preparation | undefined;
  /** The open volume. */
  readonly volume: VolumeInfo | undefined;
  /** The time step that is shown or being made, for people; `undefined` if its times are not known. */
  readonly stepLabel: string | undefined;
  /** Volumes and time steps may appear. */
  readonly watches: boolean;
  /** Others can follow. */
  readonly groups: boolean;
  /** Number of the surface that the fields of `SurfaceState` are about, and the state of the others. */
  readonly selected: number;
  readonly others: ReadonlyMap<number, SurfaceState>;
  /** Surfaces that the server allows. */
  readonly maxSurfaces: number;
  /** Number of the surface that chunks are of. */
  readonly receiving: number;
  /** Types of questions that the server answers. */
  readonly questions: readonly string[];
  /** Name of the server's device. */
  readonly device: string | undefined;
  /** When the last edit was sent, by `performance.now()`. */
  readonly editSentAt: number;
  /** Mesh bytes since the page was opened. */
  readonly bytesReceived: number;
}

export type ViewerEvent =
  | { readonly type: "connection"; readonly state: ConnectionState }
  | { readonly type: "volumes"; readonly volumes: readonly VolumeSummary[] }
  /** The user asked for a volume or step. */
  | { readonly type: "open"; readonly target: Target }
  /** Other surfaces or values are in force: the user changed them. */
  | { readonly type: "surfaces"; readonly surfaces: readonly { readonly number: number; readonly view: View }[]; readonly selected: number }
  /** An edit of a surface was sent. */
  | { readonly type: "sent"; readonly surface: number; readonly at: number }
  | { readonly type: "message"; readonly message: ServerMessage }
  | { readonly type: "chunk"; readonly bytes: number }
  /** The scene shows a prefix of a surface from the next frame on. */
  | ({ readonly type: "swap"; readonly surface: number } & ShownPrefix)
  /** The distances of a surface's vertices are on its meshes. */
  | { readonly type: "distances"; readonly surface: number; readonly generation: number; readonly distances: Distances }
  /** A frame was rendered. */
  | { readonly type: "frame"; readonly at: number };

/** What of an `open` is in the state after its answer. */
const ANSWERED = { opening: false, openedShare: undefined, preparing: undefined } as const;

export const INITIAL_STATE: ViewerState = {
  ...NEW_SURFACE,
  ...ANSWERED,
  connection: "connecting",
  volumes: undefined,
  target: undefined,
  volume: undefined,
  stepLabel: undefined,
  watches: false,
  groups: false,
  selected: 0,
  others: new Map(),
  maxSurfaces: 1,
  receiving: 0,
  questions: [],
  device: undefined,
  editSentAt: 0,
  bytesReceived: 0,
};

export function reduce(state: ViewerState, event: ViewerEvent): ViewerState {
  switch (event.type) {
    case "connection":
      return everySurface({ ...state, connection: event.state }, (one) => ({ ...one, working: event.state === "connected" && one.working }));
    case "volumes":
      return { ...state, volumes: event.volumes };
    case "open":
      return everySurface({ ...state, target: event.target, ...ANSWERED, opening: true }, (one) => ({ ...one, refusal: undefined }));
    case "surfaces":
      return arranged(state, event);
    case "sent":
      return inSurface({ ...state, editSentAt: event.at }, event.surface, (one) => ({ ...one, working: true, refusal: undefined, sentView: one.view }));
    case "message":
      return receive(state, event.message);
    case "chunk":
      return inSurface({ ...state, bytesReceived: state.bytesReceived + event.bytes }, state.receiving, (one) => ({
        ...one,
        progress: one.progress && { ...one.progress, bytes: one.progress.bytes + event.bytes },
      }));
    case "swap": {
      const { generation, level, final } = event;
      return inSurface(state, event.surface, (one) => ({ ...one, shown: { generation, level, final }, frameDue: true }));
    }
    case "distances":
      return inSurface(state, event.surface, (one) => ({ ...one, answers: takeDistances(one, event.generation, event.distances) }));
    case "frame":
      return everySurface(state, (one) => frame(one, event.at));
  }
}

/** What is known of a surface that stays is kept. */
function arranged(state: ViewerState, { surfaces, selected }: Extract<ViewerEvent, { type: "surfaces" }>): ViewerState {
  if (state.view === undefined) return state;
  const known = surfacesOf(state);
  const others = new Map(surfaces.map(({ number, view }) => [number, { ...(known.get(number) ?? NEW_SURFACE), view }] as const));
  const now = others.get(selected);
  others.delete(selected);
  return { ...state, ...now, selected, others };
}

/** How much of what an `open` takes is done: of the preparation of the device, or then of the bytes. */
function share(device: Preparation | undefined, { bytes, totalBytes }: { readonly bytes: number; readonly totalBytes: number }): number {
  return device === undefined ? bytes / Math.max(1, totalBytes) : device.done / Math.max(1, device.of);
}

function receive(state: ViewerState, message: ServerMessage): ViewerState {
  switch (message.type) {
    case "opening":
      return { ...state, preparing: message.device, openedShare: share(message.device, message) };
    case "opened":
      return opened(state, message);
    case "stepped":
      return stepped(state, message.label);
    case "described":
      return state.volume?.id === message.volume.id ? { ...state, volume: message.volume } : state;
    case "prefix":
      return inSurface({ ...state, receiving: message.surface }, message.surface, (one) => begun(one, message.generation));
    case "done":
      return inSurface(state, message.surface, (one) => ({ ...one, working: false, statistics: message.statistics, finished: message.generation }));
    case "measured":
      return inSurface(state, message.surface, (one) => measured(one, message));
    case "error":
      return isAboutQuestion(message) ? state : refused(state, message);
    case "removed":
      // If there is a surface of that number, the user has made it again.
      return inSurface(state, message.surface, (one) => ({ ...one, ...NEW_SURFACE, view: one.view, sentView: one.sentView, working: true }));
    case "group":
    case "led":
    case "posed":
    case "left":
    case "heartbeat":
    case "committed":
    case "superseded":
    case "probed":
    case "annotated":
      return state;
    case "distribution":
    case "curve":
      return inSurface(state, message.surface, (one) => ({ ...one, answers: take(one, message) }));
  }
}

function opened(state: ViewerState, { volume, edit, device, capabilities }: Extract<ServerMessage, { type: "opened" }>): ViewerState {
  const sameVolume = state.volume?.id === volume.id;
  const view = { ...edit, transferFunction: { points: sorted(edit.transferFunction.points) } };
  // A server from before there were questions or several surfaces does not name them.
  const { questions = [], surfaces = 1, watches = false, groups = false } = capabilities as Partial<Capabilities>;
  const stepLabel = volume.times?.label;
  const now = { ...state, ...ANSWERED, volume, stepLabel, device, questions, watches, groups, maxSurfaces: surfaces };
  if (!sameVolume) return { ...now, ...NEW_SURFACE, selected: 0, others: new Map(), view };
  // Another step replaces a surface when it arrives, another volume at once.
  const all = everySurface(now, (one) => ({ ...one, sentView: undefined, answers: outdated(one.answers), progress: undefined, finished: undefined }));
  return inSurface(all, 0, (one) => ({ ...one, view }));
}

/** After a time step, all surfaces are computed again; each is replaced when it arrives. */
function stepped(state: ViewerState, label: string | null): ViewerState {
  const now = { ...state, ...ANSWERED, stepLabel: label ?? undefined };
  return everySurface(now, (one) => ({ ...one, working: true, answers: outdated(one.answers), progress: undefined, finished: undefined }));
}

/** After a generation is done, a better surface of the same view may follow: the one on screen is finished all the same. */
function begun(state: ViewerState, generation: number): ViewerState {
  return { ...state, working: state.working || generation !== state.finished, progress: progressOf(state, generation) };
}

/** An error names its surface if a generation failed. Any other error is about the last edit, or about `open`. */
function refused(state: ViewerState, message: Extract<ServerMessage, { type: "error" }>): ViewerState {
  const now = { ...state, ...ANSWERED };
  const fail = (one: ViewerState): ViewerState => ({ ...one, working: false, refusal: message });
  if (message.surface !== undefined) return inSurface(now, message.surface, fail);
  return fail(everySurface(now, (one) => ({ ...one, working: false })));
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

/** The generations whose first frame lies between the two states and shows a prefix before the final surface. */
export function firstCoarseFrames(before: ViewerState, after: ViewerState): readonly number[] {
  const earlier = surfacesOf(before);
  return [...surfacesOf(after)].flatMap(([number, { progress, shown }]) => {
    if (progress?.firstMs === undefined || earlier.get(number)?.progress?.firstMs !== undefined) return [];
    return shown?.final === false ? [progress.generation] : [];
  });
}

const all = (state: ViewerState) => [...surfacesOf(state).values()];

/** The final surfaces are on screen. */
export function showsFinal(state: ViewerState): boolean {
  return all(state).every(({ shown, frameDue }) => shown?.final === true && !frameDue);
}

/** Something is to be seen in the next frame. */
export function isFrameDue(state: ViewerState): boolean {
  return all(state).some(({ frameDue }) => frameDue);
}

/** The generation of an edit of any surface is not done. */
export function isWorking(state: ViewerState): boolean {
  return all(state).some(({ working }) => working);
}

/** This generation is not done. */
export function isUnderWay(state: ViewerState, generation: number): boolean {
  return all(state).some(({ working, progress }) => working && progress?.generation === generation);
}
