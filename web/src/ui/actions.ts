/** What the user can do: the app does it. */

import type { Edit, Vec3, View } from "../protocol/types";
import type { Compared } from "../state/comparing";
import type { GroupAct } from "../state/group";
import type { Look } from "../state/look";
import type { PageLayers } from "../state/page";
import type { SurfaceList, SurfaceStyle } from "../state/surfaceList";
import type { Points } from "../transfer/model";
import type { AxisName } from "../world/axes";

export type MeshFormat = "glb" | "ply" | "stl" | "vtp";

/** What the user can do. A `gesture` names what a drag changes: all of it is one step of the history. */
export interface Actions {
  readonly openVolume: (id: string) => void;
  readonly goToStep: (step: number, gesture?: string) => void;
  readonly edit: (edit: Edit, gesture?: string) => void;
  /** An edit that depends on the values in force, and on those with which the volume opens. */
  readonly editByOpening: (edit: (view: View, opening: View) => Edit) => void;
  readonly editPoints: (points: Points, gesture?: string) => void;
  readonly changeLook: (look: Partial<Look>, gesture?: string) => void;
  readonly changeStyle: (number: number, style: Partial<SurfaceStyle>, gesture?: string) => void;
  /** A surface like the selected one, at another isovalue. */
  readonly addSurface: (iso: number) => void;
  /** Several surfaces at once; `opening`: with what the volume opens. */
  readonly arrangeSurfaces: (act: (surfaces: SurfaceList, opening: View) => SurfaceList | undefined) => void;
  readonly removeSurface: (number: number) => void;
  /** Edits are of this one from now on. */
  readonly selectSurface: (number: number) => void;
  readonly endGesture: () => void;
  /** Area and enclosed volume of the selected surface as it is on screen. */
  readonly sumUp: () => void;
  /** Goes through all time steps and measures the selected surface in each; `false`: stops it. */
  readonly measureOverTime: (run: boolean) => void;
  /** The tool in hand, at the centre of the picture. */
  readonly useAtCentre: () => void;
  readonly changePage: (layers: Partial<PageLayers>) => void;
  readonly undo: () => void;
  readonly redo: () => void;
  readonly fit: () => void;
  /** As a page just opened shows the surface. */
  readonly home: () => void;
  readonly lookFrom: (axis: AxisName) => void;
  readonly facing: (normal: Vec3) => Vec3;
  /** The minimum and the maximum at a surface's vertices, of its feature, from 0 to 1, or of the values of the field for its colours. */
  readonly colorSpan: (number: number, of: "feature" | "values") => readonly [number, number] | undefined;
  readonly retry: () => void;
  /** `undefined`: no longer. */
  readonly compare: (what: Compared | undefined) => void;
  /** Asks again for slices that are not there. */
  readonly retrySlices: () => void;
  readonly saveImage: (request: ImageRequest) => void;
  /** Saves `frames` images around the surface. Another call while it runs ends it. */
  readonly saveTurn: (request: ImageRequest, frames: number) => void;
  /** The address of the state that is shown. */
  readonly address: () => string;
  readonly copyLink: () => void;
  /** Of the selected surface; `cap`: closed at the faces through which it leaves the volume. */
  readonly copyCommand: (cap?: boolean) => void;
  readonly download: (format: MeshFormat, cap?: boolean) => void;
  /** All visible surfaces as one GLB. */
  readonly downloadAll: (cap?: boolean) => void;
  readonly group: (act: GroupAct) => void;
  readonly story: (act: StoryAct) => void;
}

/** Files that a story becomes. */
export type StoryFormat = "webm" | "mp4" | "images";

/** What is done with bookmarks, besides changing their list. */
export type StoryAct =
  /** Of what is shown. */
  | { readonly type: "add" }
  | { readonly type: "open"; readonly file: File }
  | { readonly type: "show"; readonly index: number }
  | { readonly type: "play"; readonly from?: number }
  | { readonly type: "record"; readonly format: StoryFormat; readonly request: ImageRequest }
  | { readonly type: "stop" };


/** What an image shows besides the surface. */
export interface ImageRequest {
  /** Pixels of the image for one on the page. */
  readonly scale: number;
  readonly transparent: boolean;
  readonly colorBar: boolean;
  readonly scaleBar: boolean;
  /** Colour and isovalue of each visible surface, if there are several. */
  readonly isovalues: boolean;
  /** Slices that are shown beside the picture. */
  readonly slices: boolean;
  /** May be empty. */
  readonly caption: string;
}
