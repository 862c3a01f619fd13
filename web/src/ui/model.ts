/** What the page's components see and do. The app fills it; components read it as signals, so that only what differs is written. */

import { createContext, createMemo, createRoot, createSignal, useContext, type Accessor } from "solid-js";
import type { NamedFile, UploadPhase } from "../net/uploads";
import { isEqual } from "../protocol/equal";
import type { JobInfo, Probed, SessionInfo, UploadInfo, UploadList } from "../protocol/types";
import type { Enclosed } from "../state/enclosed";
import type { GroupState } from "../state/group";
import { lengthScale, type LengthScale } from "../state/lengths";
import { has, LACKING, type Role } from "../state/roles";
import { brushOf, canRedoIn, canUndoIn, extentOf, FIRST_STATE, surfaceOf, viewerIn, workOf, type State } from "../state/state";
import type { SliceState } from "../state/slicing";
import type { TimeCurves } from "../state/timeCurves";
import type { ViewerState } from "../state/viewer";
import type { Actions, MeshFormat } from "./actions";

/** What can be done with volumes that the user brings. */
export interface UploadActions {
  /** Files become a volume of the server, which is opened. */
  start(files: readonly NamedFile[]): Promise<void>;
  /** Ends the upload that is under way. */
  cancel(): void;
  /** @throws if the server takes no uploads, or none of this user's */
  list(): Promise<UploadList>;
  remove(upload: UploadInfo): Promise<void>;
}

/** What can be done with batch jobs. What fails is said. */
export interface JobActions {
  /** @throws if the server does not say */
  list(): Promise<readonly JobInfo[]>;
  /** The view that is shown, for each of these. */
  submit(isovalues: readonly number[], format: MeshFormat): Promise<void>;
  cancel(job: JobInfo): Promise<void>;
  remove(job: JobInfo): Promise<void>;
  /** Saves what it has made. */
  download(job: JobInfo): Promise<void>;
}

/** Area and volume of surfaces that the user has asked for, by their numbers, as they are on screen. */
export interface SurfaceSums {
  readonly known: Accessor<ReadonlyMap<number, Enclosed | "summing">>;
  sum(surfaces: readonly number[]): void;
}

/** An upload that is under way. */
export interface Uploading {
  readonly title: string;
  readonly files: number;
  readonly phase: UploadPhase;
  /** Bytes, and those in all. */
  readonly sent: number;
  readonly total: number;
}

/** Facts about what is on screen. */
export interface SurfaceFacts {
  /** Triangles of each level, finest first, of all surfaces, and of each by its number. */
  readonly levelTriangles: readonly number[];
  readonly levelTrianglesBySurface: readonly (readonly number[])[];
  /** It is not what the values in force ask for. */
  readonly busy: boolean;
}

/** How long a message stays that is no error. */
type Stay = "brief" | "lasting";

/** One that a question offers. */
export interface Answer {
  readonly text: string;
  readonly act: () => void;
}

/** A bookmark that is shown in its turn. */
interface Told {
  readonly index: number;
  readonly text: string;
}

/** A message to the user: an error, what was done, or a question. */
export interface Toast {
  readonly text: string;
  readonly good: boolean;
  /** Retries what has failed, if that may help. */
  readonly retry?: () => void;
  readonly answers?: readonly Answer[];
}

export interface Connection {
  readonly isConnected: boolean;
  /** Why the last one was closed, if that is known. */
  readonly reason: string | undefined;
  /** Address at which to sign in, if that helps. */
  readonly signIn?: string;
  /** Whether people sign in here, and so out. */
  readonly canSignOut?: boolean;
}

/** Shown at once; a further one replaces the oldest. */
const MAX_TOASTS = 4;
const BRIEF_MS = 4000;

const equals = { equals: isEqual };

/** A value that components read as a signal and others set. */
export interface Cell<T> extends Accessor<T> {
  readonly set: (value: T) => void;
}

function cell<T>(first: T, options?: typeof equals): Cell<T> {
  const [get, set] = createSignal(first, options);
  return Object.assign(() => get(), { set: (value: T) => void set(() => value) });
}

const NO_FACTS: SurfaceFacts = { levelTriangles: [], levelTrianglesBySurface: [], busy: false };

/** A memo that lives as long as the page. */
const memo = <T>(get: () => T, options?: typeof equals): Accessor<T> => createRoot(() => createMemo(get, undefined, options));

export class Model {
  /** The state that is shown: what the user changes at once, what server and scene report a while later. */
  private readonly now = cell(FIRST_STATE);
  private readonly reported = cell(FIRST_STATE);
  readonly viewer: Accessor<ViewerState> = memo(() => viewerIn(this.reported()));
  readonly facts = cell(NO_FACTS, equals);
  readonly volume = this.part((state) => state.server.volume);
  /** Of the selected surface. */
  readonly view = this.part((state) => surfaceOf(state)?.view);
  readonly surfaces = this.part((state) => workOf(state).surfaces);
  readonly selected = this.part(surfaceOf);
  readonly look = this.part((state) => workOf(state).look);
  readonly page = this.part((state) => state.page);
  /** The time step that is wanted. */
  readonly step = this.part((state) => workOf(state).step);
  readonly history = this.part((state) => ({ canUndo: canUndoIn(state), canRedo: canRedoIn(state) }), equals);
  /** Radius of the brush, and the volume's longest side, world units. */
  readonly brush = this.part(brushOf);
  readonly extent = this.part(extentOf);
  /** What is compared; `waiting` for the full surface. */
  readonly comparing = this.part(({ comparing }) => (comparing?.isWaiting === true ? "waiting" : comparing?.kind));
  /** What lies under the pointer. */
  readonly probe = cell<Probed | undefined>(undefined);
  /** The value at which a point was picked on the surface; a further pick is a further object. */
  readonly picked = cell<{ readonly x: number } | undefined>(undefined);
  readonly toasts = cell<readonly Toast[]>([]);
  readonly connection = cell<Connection>({ isConnected: false, reason: undefined });
  /** Slices beside the picture, by the axes across them. */
  readonly slices = cell<readonly SliceState[]>([]);
  /** Share of a turntable that is made; `undefined` while none is. */
  readonly turning = cell<number | undefined>(undefined);
  /** `undefined` while nothing is uploaded. */
  readonly uploading = cell<Uploading | undefined>(undefined);
  /** Of the surface on screen; `undefined` until the user asks. */
  readonly enclosed = cell<Enclosed | "summing" | undefined>(undefined);
  /** What the user may do; `undefined` until the server has said it. */
  readonly session = cell<SessionInfo | undefined>(undefined, equals);
  /** The group that the page is in. */
  readonly group = cell<GroupState | undefined>(undefined, equals);
  /** The bookmark that a story shows; `undefined` while none is played. */
  readonly telling = cell<Told | undefined>(undefined);
  /** What was measured over time; `undefined` until the user asks. */
  readonly curves = cell<TimeCurves | undefined>(undefined);
  /** Set before the page is shown. */
  uploads: UploadActions | undefined;
  jobs: JobActions | undefined;
  sums: SurfaceSums | undefined;
  /** Frames are rendered by a GPU: there are effects on screen. */
  onGpu = false;
  /** Told of each error that is shown. */
  onError: ((text: string) => void) | undefined;

  constructor(readonly actions: Actions) {}

  /** A part of what the user changes; it changes when it is another object. */
  private part<T>(select: (state: State) => T, options?: typeof equals): Accessor<T> {
    return memo(() => select(this.now()), options);
  }

  /** What the user has changed is shown at once. */
  showWork(state: State): void {
    this.now.set(state);
  }

  /** What server and scene report, of which there is much during an edit. */
  showProgress(state: State, facts: SurfaceFacts): void {
    this.reported.set(state);
    this.facts.set(facts);
  }

  /** Whether the user may do what a role is for. */
  may(role: Role): boolean {
    return has(this.session(), role);
  }

  /** Whether the user may have batch jobs made here. */
  hasJobs(): boolean {
    return this.session()?.jobs === true;
  }

  /** Whether the server takes volumes of the user; until it has said so, it may. */
  takesUploads(): boolean {
    return this.session()?.uploads !== false;
  }

  /** An error, unless it says how long it stays. */
  toast(text: string, stay?: Stay): void {
    this.addToast({ text, good: stay !== undefined });
    if (stay === undefined) this.onError?.(text);
    if (stay === "brief") setTimeout(() => this.dismiss(text), BRIEF_MS);
  }

  /** An error, and a way to try again. */
  offerRetry(text: string, act: () => void): void {
    const retry = () => {
      this.dismiss(text);
      act();
    };
    this.addToast({ text, good: false, retry });
    this.onError?.(text);
  }

  /** A question with some answers; no answer is one too. */
  readonly ask = (text: string, answers: readonly Answer[]): void => {
    const closing = answers.map((answer) => ({
      ...answer,
      act: () => {
        this.dismiss(text);
        answer.act();
      },
    }));
    this.addToast({ text, good: true, answers: closing });
  };

  private addToast(toast: Toast): void {
    const others = this.toasts().filter(({ text }) => text !== toast.text);
    this.toasts.set([...others, toast].slice(-MAX_TOASTS));
  }

  /** Something that the user may not do: the message stays beyond the next surface, and the embedding page is notified. */
  refuse(reason: string): void {
    this.toast(reason, "lasting");
    this.onError?.(reason);
  }

  /** Whether surfaces may be changed; else it is said why not. */
  mayEdit(): boolean {
    const may = this.may("edit");
    if (!may) this.toast(LACKING.edit, "brief");
    return may;
  }

  /** For a moment, if there is something to say. */
  readonly say = (text: string | undefined): void => {
    if (text !== undefined) this.toast(text, "brief");
  };

  dismiss(text: string): void {
    this.toasts.set(this.toasts().filter((toast) => toast.text !== text));
  }

  /** Errors do not outlive the surface that follows them. */
  clearErrors(): void {
    this.toasts.set(this.toasts().filter((toast) => toast.good));
  }
}

export const ModelContext = createContext<Model>();

export function useModel(): Model {
  const model = useContext(ModelContext);
  if (model === undefined) throw new Error("no page around this component");
  return model;
}

/** How lengths of the open volume are said. */
export function useScale(): () => LengthScale {
  const { volume } = useModel();
  return () => lengthScale(volume());
}

/** The open volume's smallest distance between samples. */
export function useSpacing(): () => number {
  const scale = useScale();
  return () => scale().spacing;
}
