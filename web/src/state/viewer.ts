/** What the server says of itself, of the open volume and of each surface on screen. Pure. */

import type { ConnectionState } from "../net/connection";
import type { Capabilities, Preparation, ServerMessage, View, VolumeInfo, VolumeSummary } from "../protocol/types";
import { isAboutQuestion, outdated, take, takeDistances } from "./answers";
import type { Distances } from "./distances";
import { awaitsCamera, isForCamera, NEW_SURFACE, type Progress, type ShownPrefix, type SurfaceState } from "./surfaceState";

/** A volume at a time step. */
export interface Target {
  readonly volume: string;
  readonly step: number;
}

export interface ServerState {
  readonly connection: ConnectionState;
  /** `undefined` until the server has listed them. */
  readonly volumes: readonly VolumeSummary[] | undefined;
  /** What was asked for last. */
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
  /** The camera of the member in control has moved since that member's last edit. */
  readonly isLedByCamera: boolean;
  /** By the numbers of surfaces, which ascend. */
  readonly known: ReadonlyMap<number, SurfaceState>;
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

/** What is known, with what is known of one surface among the fields. */
export interface SeenSurface extends ServerState, SurfaceState {
  readonly selected: number;
}

/** The same of the selected surface, with the values in force. */
export interface ViewerState extends SeenSurface {
  readonly view: View | undefined;
  readonly surfaces: readonly ViewedSurface[];
}

/** Values in force of a surface. */
interface ViewedSurface {
  readonly number: number;
  readonly view: View;
}

/** Which surfaces there are, and which one is selected. */
interface Viewed {
  readonly surfaces: readonly ViewedSurface[];
  readonly selected: number;
}

/** An event of server, scene or connection. */
export type ServerEvent =
  | { readonly type: "connection"; readonly state: ConnectionState }
  | { readonly type: "volumes"; readonly volumes: readonly VolumeSummary[] }
  /** An edit of a surface was sent. */
  | { readonly type: "sent"; readonly surface: number; readonly at: number }
  /** A camera was sent, for which the server makes these surfaces. */
  | { readonly type: "camera"; readonly surfaces: readonly number[] }
  | { readonly type: "message"; readonly message: ServerMessage }
  | { readonly type: "chunk"; readonly bytes: number }
  /** The scene shows a prefix of a surface from the next frame on. */
  | ({ readonly type: "swap"; readonly surface: number } & ShownPrefix)
  /** The distances of a surface's vertices are on its meshes. */
  | { readonly type: "distances"; readonly surface: number; readonly generation: number; readonly distances: Distances }
  /** A frame was rendered. */
  | { readonly type: "frame"; readonly at: number };

const SERVER_EVENTS: readonly string[] = ["connection", "volumes", "sent", "camera", "message", "chunk", "swap", "distances", "frame"] satisfies ServerEvent["type"][];

export const isOfServer = (event: { readonly type: string }): event is ServerEvent => SERVER_EVENTS.includes(event.type);

/** Generations of a surface whose fields are remembered until they are on screen. Two can be on their way, and others may have begun between them. */
const REMEMBERED_FIELDS = 32;

/** What of an `open` is in the state after its answer. */
const ANSWERED = { opening: false, openedShare: undefined, preparing: undefined } as const;

export const FIRST_SERVER: ServerState = {
  ...ANSWERED,
  connection: "connecting",
  volumes: undefined,
  target: undefined,
  volume: undefined,
  stepLabel: undefined,
  watches: false,
  groups: false,
  isLedByCamera: false,
  known: new Map([[0, NEW_SURFACE]]),
  maxSurfaces: 1,
  receiving: 0,
  questions: [],
  device: undefined,
  editSentAt: 0,
  bytesReceived: 0,
};

/** @param viewed the surfaces at the time of the event */
export function reduceServer(state: ServerState, event: ServerEvent, viewed: Viewed): ServerState {
  switch (event.type) {
    case "connection":
      return everySurface({ ...state, connection: event.state }, (one) => ({ ...one, working: event.state === "connected" && one.working, cameraAfter: undefined }));
    case "volumes":
      return { ...state, volumes: event.volumes };
    case "sent":
      return inSurface({ ...state, editSentAt: event.at }, event.surface, (one) => ({ ...one, working: true, refusal: undefined, sentView: viewOf(viewed, event.surface) }));
    case "camera":
      return cameraSent(state, event.surfaces);
    case "message":
      return receive(state, event.message, viewed);
    case "chunk":
      return inSurface({ ...state, bytesReceived: state.bytesReceived + event.bytes }, state.receiving, (one) => ({
        ...one,
        progress: one.progress && !isForCamera(one) ? { ...one.progress, bytes: one.progress.bytes + event.bytes } : one.progress,
      }));
    case "swap": {
      const { generation, level, final } = event;
      return inSurface(state, event.surface, (one) => {
        const madeFields = new Map([...one.madeFields].filter(([made]) => made >= generation));
        return { ...one, shown: { generation, level, final }, madeFields, shownField: madeFields.get(generation) ?? null, frameDue: true };
      });
    }
    case "distances":
      return inSurface(state, event.surface, (one) => ({ ...one, answers: takeDistances(seen(state, event.surface), event.generation, event.distances) }));
    case "frame":
      return everySurface(state, (one) => frame(one, event.at));
  }
}

/** The user, or another member of the group, asked for a volume or step. */
export function openTarget(state: ServerState, target: Target): ServerState {
  return everySurface({ ...state, target, ...ANSWERED, opening: true }, (one) => ({ ...one, refusal: undefined }));
}

/** Keeps what is known of the surfaces of these numbers alone. */
export function keepSurfaces(state: ServerState, numbers: readonly number[]): ServerState {
  const { known } = state;
  if (numbers.length === known.size && numbers.every((number) => known.has(number))) return state;
  const ascending = [...numbers].sort((a, b) => a - b);
  return { ...state, known: new Map(ascending.map((number) => [number, known.get(number) ?? NEW_SURFACE])) };
}

export function seen(state: ServerState, number: number): SeenSurface {
  return { ...state, ...(state.known.get(number) ?? NEW_SURFACE), selected: number };
}

export function viewerOf(state: ServerState, viewed: Viewed): ViewerState {
  return { ...seen(state, viewed.selected), view: viewOf(viewed), surfaces: viewed.surfaces };
}

const viewOf = ({ surfaces, selected }: Viewed, number = selected) => surfaces.find((surface) => surface.number === number)?.view;

/** Changes one surface. What comes of one that was removed changes nothing. */
function inSurface(state: ServerState, number: number, change: (one: SurfaceState) => SurfaceState): ServerState {
  const one = state.known.get(number);
  return one === undefined ? state : { ...state, known: new Map([...state.known]).set(number, change(one)) };
}

/** Changes each surface; the state stays the same object if none of them changes. */
function everySurface(state: ServerState, change: (one: SurfaceState) => SurfaceState): ServerState {
  const changed = [...state.known].map(([number, one]) => [number, change(one)] as const);
  return changed.every(([number, one]) => one === state.known.get(number)) ? state : { ...state, known: new Map(changed) };
}

/** How much of what an `open` takes is done: of the preparation of the device, or then of the bytes. */
function share(device: Preparation | undefined, { bytes, totalBytes }: { readonly bytes: number; readonly totalBytes: number }): number {
  return device === undefined ? bytes / Math.max(1, totalBytes) : device.done / Math.max(1, device.of);
}

function receive(state: ServerState, message: ServerMessage, viewed: Viewed): ServerState {
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
      return inSurface({ ...state, receiving: message.surface }, message.surface, (one) => {
        const { generation, colorField = null } = message;
        return { ...begun(one, generation, state), madeFields: new Map([...one.madeFields, [generation, colorField] as const].slice(-REMEMBERED_FIELDS)) };
      });
    case "done":
      return inSurface(state, message.surface, (one) => finished(one, message));
    case "measured":
      return inSurface(state, message.surface, (one) => measured(one, message));
    case "error":
      return isAboutQuestion(message) ? state : refused(state, message, viewed.selected);
    case "removed":
      // If there is a surface of that number, the user has made it again.
      return inSurface(state, message.surface, (one) => ({ ...NEW_SURFACE, sentView: one.sentView, working: true }));
    case "led":
      return { ...state, isLedByCamera: false };
    case "posed":
      return message.camera === undefined ? state : { ...state, isLedByCamera: true };
    case "group":
    case "left":
    case "heartbeat":
    case "committed":
    case "superseded":
    case "probed":
    case "annotated":
      return state;
    case "distribution":
    case "curve":
      return inSurface(state, message.surface, (one) => ({ ...one, answers: take(seen(state, message.surface), message) }));
  }
}

function opened(state: ServerState, { volume, device, capabilities }: Extract<ServerMessage, { type: "opened" }>): ServerState {
  // A server from before there were questions or several surfaces does not name them.
  const { questions = [], surfaces = 1, watches = false, groups = false } = capabilities as Partial<Capabilities>;
  const stepLabel = volume.times?.label;
  const now = { ...state, ...ANSWERED, volume, stepLabel, device, questions, watches, groups, maxSurfaces: surfaces, isLedByCamera: false };
  if (state.volume?.id !== volume.id) return { ...now, known: FIRST_SERVER.known };
  // Another step replaces a surface when it arrives, another volume at once.
  // The numbers of generations begin again with a connection.
  const again = { sentView: undefined, madeFields: NEW_SURFACE.madeFields, progress: undefined, finished: undefined, cameraAfter: undefined };
  return everySurface(now, (one) => ({ ...one, ...again, answers: outdated(one.answers) }));
}

/** After a time step, all surfaces are computed again; each is replaced when it arrives. */
function stepped(state: ServerState, label: string | null): ServerState {
  const now = { ...state, ...ANSWERED, stepLabel: label ?? undefined };
  return everySurface(now, (one) => ({ ...one, working: true, answers: outdated(one.answers), progress: undefined, finished: undefined }));
}

function cameraSent(state: ServerState, numbers: readonly number[]): ServerState {
  const known = [...state.known].map(([number, one]) => {
    const newest = Math.max(one.progress?.generation ?? 0, one.finished ?? 0);
    return [number, { ...one, cameraAfter: numbers.includes(number) ? newest : undefined }] as const;
  });
  return { ...state, known: new Map(known) };
}

/** After a generation is done, a better surface of the same view or one for another camera may follow: the one on screen is finished all the same. */
function begun(state: SurfaceState, generation: number, { editSentAt, isLedByCamera }: ServerState): SurfaceState {
  const isNew = generation !== state.finished;
  const isOfCamera = isNew && !state.working && state.finished !== undefined && (awaitsCamera(state) || isLedByCamera);
  if (isOfCamera) return { ...state, progress: state.progress && { ...state.progress, generation } };
  return { ...state, working: state.working || isNew, edited: isNew ? generation : state.edited, progress: progressOf(state, generation, editSentAt) };
}

function finished(state: SurfaceState, { generation, statistics }: Extract<ServerMessage, { type: "done" }>): SurfaceState {
  const cameraAfter = state.cameraAfter !== undefined && generation > state.cameraAfter ? undefined : state.cameraAfter;
  return { ...state, working: false, statistics, finished: generation, cameraAfter };
}

/** An error names its surface if a generation failed. Any other error is about the last edit, or about `open`. */
function refused(state: ServerState, message: Extract<ServerMessage, { type: "error" }>, selected: number): ServerState {
  const now = { ...state, ...ANSWERED };
  const fail = (one: SurfaceState): SurfaceState => ({ ...one, working: false, refusal: message, cameraAfter: undefined });
  if (message.surface !== undefined) return inSurface(now, message.surface, fail);
  return inSurface(everySurface(now, (one) => ({ ...one, working: false, cameraAfter: undefined })), selected, fail);
}

/** The statistics get the error that was measured after them. */
function measured(state: SurfaceState, { generation, error }: Extract<ServerMessage, { type: "measured" }>): SurfaceState {
  if (state.statistics === undefined || state.finished !== generation) return state;
  return { ...state, statistics: { ...state.statistics, error } };
}

function progressOf(state: SurfaceState, generation: number, sentAt: number): Progress {
  if (state.progress?.generation === generation) return state.progress;
  return { generation, startedAt: sentAt, bytes: 0, firstMs: undefined, lastMs: undefined };
}

function frame(state: SurfaceState, at: number): SurfaceState {
  const { progress, shown, frameDue } = state;
  if (!frameDue) return state;
  if (progress === undefined || progress.generation !== shown?.generation) return { ...state, frameDue: false };
  const elapsed = at - progress.startedAt;
  const firstMs = progress.firstMs ?? elapsed;
  const lastMs = progress.lastMs ?? (shown.final ? elapsed : undefined);
  return { ...state, frameDue: false, progress: { ...progress, firstMs, lastMs } };
}

/** The generations whose first frame lies between the two states and shows a prefix before the final surface. */
export function firstCoarseFrames(before: ServerState, after: ServerState): readonly number[] {
  return [...after.known].flatMap(([number, { progress, shown }]) => {
    if (progress?.firstMs === undefined || before.known.get(number)?.progress?.firstMs !== undefined) return [];
    return shown?.final === false ? [progress.generation] : [];
  });
}

const all = (state: ServerState) => [...state.known.values()];

/** The final surfaces are on screen. */
export function showsFinal(state: ServerState): boolean {
  return all(state).every(({ shown, frameDue }) => shown?.final === true && !frameDue);
}

/** Something is to be seen in the next frame. */
export function isFrameDue(state: ServerState): boolean {
  return all(state).some(({ frameDue }) => frameDue);
}

/** Whether a proxy has several servers, among which it chooses by the volume in an address. */
export function hasSeveralServers({ volumes }: Pick<ServerState, "volumes">): boolean {
  return volumes?.some(({ jobServer }) => typeof jobServer === "string") === true;
}

/** The generation of an edit of any surface is not done. */
export function isWorking(state: ServerState): boolean {
  return all(state).some(({ working }) => working);
}

/** This generation is not done. */
export function isUnderWay(state: ServerState, generation: number): boolean {
  return all(state).some(({ working, progress }) => working && progress?.generation === generation);
}

/** All that changes on screen follows a camera. */
export function isFollowingCamera(state: ServerState): boolean {
  return !isWorking(state) && all(state).some(isForCamera);
}

/** A surface for the camera that was sent last is still to come. */
export function isCameraAwaited(state: ServerState): boolean {
  return all(state).some(awaitsCamera);
}
