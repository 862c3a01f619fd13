/** What the page's components see and do. The app fills it; components read it as signals, so that only what differs is written. */

import { createContext, createSignal, useContext, type Accessor } from "solid-js";
import type { NamedFile, UploadPhase } from "../net/uploads";
import type { JobInfo, Probed, SessionInfo, UploadInfo, UploadList, View, VolumeInfo } from "../protocol/types";
import type { Enclosed } from "../state/enclosed";
import type { GroupState } from "../state/group";
import { lengthScale, type LengthScale } from "../state/lengths";
import type { Look } from "../state/look";
import { has, LACKING, type Role } from "../state/roles";
import type { PageLayers, Store } from "../state/store";
import type { Surface, SurfaceList } from "../state/surfaceList";
import type { TimeCurves } from "../state/timeCurves";
import { INITIAL_STATE, type ViewerState } from "../state/viewer";
import type { Actions, Compared, MeshFormat } from "./actions";
import { SlicesBeside } from "./slicePanel/beside";

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

const same = { equals: (a: unknown, b: unknown) => JSON.stringify(a) === JSON.stringify(b) };

export class Model {
  readonly viewer: Accessor<ViewerState>;
  readonly facts: Accessor<SurfaceFacts>;
  readonly volume: Accessor<VolumeInfo | undefined>;
  /** Of the selected surface. */
  readonly view: Accessor<View | undefined>;
  readonly surfaces: Accessor<SurfaceList>;
  readonly selected: Accessor<Surface | undefined>;
  readonly look: Accessor<Look>;
  readonly page: Accessor<PageLayers>;
  /** The time step that is wanted. */
  readonly step: Accessor<number>;
  readonly history: Accessor<{ readonly canUndo: boolean; readonly canRedo: boolean }>;
  /** What lies under the pointer. */
  readonly probe: Accessor<Probed | undefined>;
  /** The value at which a point was picked on the surface; a further pick is a further object. */
  readonly picked: Accessor<{ readonly x: number } | undefined>;
  /** Radius of the brush, and the volume's longest side, world units. */
  readonly brush: Accessor<number>;
  readonly extent: Accessor<number>;
  readonly toasts: Accessor<readonly Toast[]>;
  readonly connection: Accessor<Connection>;
  /** Set before the page is shown. */
  uploads: UploadActions | undefined;
  jobs: JobActions | undefined;
  readonly beside = new SlicesBeside();
  sums: SurfaceSums | undefined;
  /** Surfaces with the ranges of features that the server has chosen. Set before the page is shown. */
  ranged = (_: ViewerState, surfaces: SurfaceList): SurfaceList => surfaces;
  /** Frames are rendered by a GPU: there are effects on screen. */
  onGpu = false;
  /** Told of each error that is shown. */
  onError: ((text: string) => void) | undefined;
  /** Share of a turntable that is made; `undefined` while none is. */
  readonly turning: Accessor<number | undefined>;
  /** `undefined` while nothing is uploaded. */
  readonly uploading: Accessor<Uploading | undefined>;
  /** What is compared; `waiting` for the full surface. */
  readonly comparing: Accessor<Compared | "waiting" | undefined>;
  /** Of the surface on screen; `undefined` until the user asks. */
  readonly enclosed: Accessor<Enclosed | "summing" | undefined>;
  /** What the user may do; `undefined` until the server has said it. */
  private readonly session: Accessor<SessionInfo | undefined>;
  /** The group that the page is in. */
  readonly group: Accessor<GroupState | undefined>;
  /** The bookmark that a story shows; `undefined` while none is played. */
  readonly telling: Accessor<Told | undefined>;
  /** What was measured over time; `undefined` until the user asks. */
  readonly curves: Accessor<TimeCurves | undefined>;
  private readonly set;

  constructor(
    store: Store,
    readonly actions: Actions,
  ) {
    const [viewer, setViewer] = createSignal(INITIAL_STATE);
    const [facts, setFacts] = createSignal<SurfaceFacts>({ levelTriangles: [], levelTrianglesBySurface: [], busy: false }, same);
    const [volume, setVolume] = createSignal<VolumeInfo>();
    const [view, setView] = createSignal<View>();
    const [surfaces, setSurfaces] = createSignal(store.surfaces);
    const [selected, setSelected] = createSignal(store.surface);
    const [look, setLook] = createSignal(store.look);
    const [page, setPage] = createSignal(store.page);
    const [step, setStep] = createSignal(store.step);
    const [history, setHistory] = createSignal({ canUndo: false, canRedo: false }, same);
    const [probe, showProbe] = createSignal<Probed>();
    const [picked, setPicked] = createSignal<{ readonly x: number }>();
    const [brush, setBrush] = createSignal(store.brush);
    const [extent, setExtent] = createSignal(store.extent);
    const [toasts, setToasts] = createSignal<readonly Toast[]>([]);
    const [connection, setConnection] = createSignal<Connection>({ isConnected: false, reason: undefined });
    [this.viewer, this.facts, this.volume, this.view, this.look] = [viewer, facts, volume, view, look];
    [this.surfaces, this.selected] = [surfaces, selected];
    this.step = step;
    [this.page, this.history, this.toasts, this.connection] = [page, history, toasts, connection];
    [this.probe, this.picked, this.brush, this.extent] = [probe, picked, brush, extent];
    const [turning, setTurning] = createSignal<number>();
    const [uploading, setUploading] = createSignal<Uploading>();
    this.uploading = uploading;
    const [comparing, setComparing] = createSignal<Compared | "waiting">();
    const [enclosed, setEnclosed] = createSignal<Enclosed | "summing">();
    [this.turning, this.comparing, this.enclosed] = [turning, comparing, enclosed];
    const [telling, setTelling] = createSignal<Told>();
    this.telling = telling;
    const [curves, setCurves] = createSignal<TimeCurves>();
    this.curves = curves;
    const [group, setGroup] = createSignal<GroupState | undefined>(undefined, same);
    const [session, setSession] = createSignal<SessionInfo | undefined>(undefined, same);
    [this.group, this.session] = [group, session];
    this.set = { setTelling, setCurves, setGroup, setSession, setUploading, setStep, setSurfaces, setSelected, showProbe, setPicked, setBrush, setExtent, setTurning, setComparing, setEnclosed, setViewer, setFacts, setVolume, setView, setLook, setPage, setHistory, setToasts, setConnection };
  }

  /** What the user has changed is shown at once. */
  showWork({ viewer, view, surfaces, surface, look, page, step, brush, extent, canUndo, canRedo }: Store): void {
    const { set } = this;
    set.setVolume(viewer.volume);
    set.setSurfaces(surfaces);
    set.setSelected(surface);
    set.setView(view);
    set.setLook(look);
    set.setPage(page);
    set.setStep(step);
    set.setBrush(brush);
    set.setExtent(extent);
    set.setHistory({ canUndo, canRedo });
  }

  /** What server and scene report, of which there is much during an edit. */
  showProgress(viewer: ViewerState, facts: SurfaceFacts): void {
    this.set.setViewer(viewer);
    this.set.setFacts(facts);
  }

  showProbe(probed: Probed | undefined): void {
    this.set.showProbe(probed);
  }

  /** The editor adds a point at this value. */
  pick(x: number): void {
    this.set.setPicked({ x });
  }

  showTurning(share: number | undefined): void {
    this.set.setTurning(share);
  }

  showUploading(uploading: Uploading | undefined): void {
    this.set.setUploading(uploading);
  }

  showComparing(what: Compared | "waiting" | undefined): void {
    this.set.setComparing(what);
  }

  showEnclosed(enclosed: Enclosed | "summing" | undefined): void {
    this.set.setEnclosed(enclosed);
  }

  showTelling(told: Told | undefined): void {
    this.set.setTelling(told);
  }

  showCurves(curves: TimeCurves): void {
    this.set.setCurves(curves);
  }

  showGroup(group: GroupState | undefined): void {
    this.set.setGroup(group);
  }

  showSession(session: SessionInfo): void {
    this.set.setSession(session);
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

  showConnection(connection: Connection): void {
    this.set.setConnection(connection);
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
    this.set.setToasts([...others, toast].slice(-MAX_TOASTS));
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
    this.set.setToasts(this.toasts().filter((toast) => toast.text !== text));
  }

  /** Errors do not outlive the surface that follows them. */
  clearErrors(): void {
    this.set.setToasts(this.toasts().filter((toast) => toast.good));
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
