/**
 * The state of the page: what the server says, what the user made of the open volume (`work`, with one history of it), and the layers of the
 * page. One immutable value that `reduce` (`reduce.ts`) alone replaces; what an event does not change stays the same object. Each volume keeps its own work
 * while another one is open. Pure.
 */

import type { Edit, View } from "../protocol/types";
import { askedView, type Comparing } from "./comparing";
import { canUndo, type History } from "./history";
import { DEFAULT_LOOK, openingLook, type Look, type Pose } from "./look";
import { FIRST_PAGE, type PageLayers } from "./page";
import type { Slicing } from "./slicing";
import type { Story } from "./story";
import type { Surface, SurfaceList, SurfaceStyle } from "./surfaceList";
import { FIRST_SERVER, viewerOf, type ServerState, type Target, type ViewerState } from "./viewer";

/** What undo and redo cover. */
export interface Work {
  readonly surfaces: SurfaceList;
  /** Number of the surface that edits are of. Selecting another one is no step of the history, but a step brings its own back. */
  readonly selected: number;
  readonly look: Look;
  /** Time step that is wanted. */
  readonly step: number;
}

/** Before a volume is open. */
const NO_WORK: Work = { surfaces: [], selected: 0, look: DEFAULT_LOOK, step: 0 };

/** State of a volume that is kept while another one is open. */
interface Remembered {
  readonly history: History<Work>;
  readonly pose: Pose | undefined;
  readonly crosshair: Slicing["at"];
}

/** What a link asks for. What is not named is as the volume opens. */
export interface Wish {
  readonly surfaces: readonly { readonly edit: Edit; readonly style: Partial<SurfaceStyle> }[];
  /** Place of the selected one among them. */
  readonly selected: number;
  readonly look: Partial<Look>;
  readonly pose: Pose | undefined;
  readonly step?: number;
  readonly slicing?: Slicing;
  /** Without one the bookmarks stay. */
  readonly story?: Story;
}

export interface State {
  readonly server: ServerState;
  /** `undefined` until a volume is open. */
  readonly history: History<Work> | undefined;
  /** The server's own values of the open volume: a link names what differs from them. */
  readonly opening: View | undefined;
  readonly page: PageLayers;
  /** What is compared side by side. */
  readonly comparing: Comparing | undefined;
  /** By volumes. */
  readonly remembered: ReadonlyMap<string, Remembered>;
  /** What a link asks for, once its volume is open. */
  readonly wish: (Wish & { readonly volume: string }) | undefined;
  /** The page is going to leave the open volume, with the camera there. */
  readonly leaving: { readonly pose: Pose | undefined } | undefined;
}

export const FIRST_STATE: State = {
  server: FIRST_SERVER,
  history: undefined,
  opening: undefined,
  page: FIRST_PAGE,
  comparing: undefined,
  remembered: new Map(),
  wish: undefined,
  leaving: undefined,
};

/** What undo and redo cover, now. */
export const workOf = (state: State): Work => state.history?.current ?? NO_WORK;

/** The surface that edits are of. */
export function surfaceOf(state: State): Surface | undefined {
  const { surfaces, selected } = workOf(state);
  return surfaces.find(({ number }) => number === selected);
}

/** What is known, and that of the selected surface. */
export const viewerIn = (state: State): ViewerState => viewerOf(state.server, workOf(state));

/** The volume's longest side, world units. */
export function extentOf({ server: { volume } }: State): number {
  const { dims, spacing } = volume?.geometry ?? { dims: [2], spacing: [1] };
  return Math.max(...dims.map((n, axis) => (n - 1) * (spacing[axis] ?? 1)));
}

/** The radius of the brush until another one is chosen, as a share of the volume's longest side. */
const FIRST_BRUSH = 0.05;

/** Radius of the regions of interest that are marked, world units. */
export const brushOf = (state: State): number => state.page.brush ?? Number((FIRST_BRUSH * extentOf(state)).toPrecision(2));

/** How the open volume is shown first. */
export const openingLookOf = ({ server: { volume } }: State): Look => (volume === undefined ? DEFAULT_LOOK : openingLook(volume));

export const canUndoIn = ({ history }: State): boolean => history !== undefined && canUndo(history);
export const canRedoIn = ({ history }: State): boolean => (history?.future.length ?? 0) > 0;

/** Whether there is work of a volume, open or left. */
export const knows = ({ remembered, server }: State, volume: string): boolean => server.volume?.id === volume || remembered.has(volume);

/** The step at which a volume is shown, or was left. */
export function stepOf(state: State, volume: string): number {
  const history = state.server.volume?.id === volume ? state.history : state.remembered.get(volume)?.history;
  return history?.current.step ?? 0;
}

/** The pose that the camera shall have once a volume is open, if that is known. */
export function poseFor({ remembered, wish }: State, volume: string): Pose | undefined {
  return wish?.volume === volume ? wish.pose : remembered.get(volume)?.pose;
}

/** What the server is asked for: the volume, the step, and the surfaces, that first whose budget counts for all. */
export function wantedOf(state: State): { readonly target: Target | undefined; readonly surfaces: readonly { readonly number: number; readonly view: View }[] } {
  const { surfaces, selected } = workOf(state);
  const ordered = [...surfaces].sort((a, b) => Number(b.number === selected) - Number(a.number === selected));
  return { target: state.server.target, surfaces: ordered.map(({ number, view }) => ({ number, view: askedView(view, state.comparing) })) };
}
