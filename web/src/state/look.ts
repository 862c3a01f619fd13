/** How the surface is shown: what changes nothing on the server. Pure. */

import { LEVELS } from "../protocol/generated";
import type { Vec3, VolumeInfo } from "../protocol/types";
import type { Measure } from "./measure";

/**
 * One colour, or what colours stand for: those of the control points, the blended value, the field that matters in its units, the importance, the
 * level, the distance to the isosurface.
 */
export const COLOR_BY = ["material", "transfer", "feature", "field", "importance", "level", "error"] as const;
export type ColorBy = (typeof COLOR_BY)[number];
export const MAPS = [
  "batlow", "viridis", "cividis", "magma", "inferno", "plasma", "cubehelix", "greys", "ylor", "ylorrd", "ylgnbu", "vik", "rdbu", "puor",
] as const;
export const MATERIALS = ["ivory", "clay", "tissue", "metal"] as const;
/** The most isolines: more are no lines any more. */
export const MAX_ISOLINES = 24;
/** Factors by which the world can be shown higher. */
export const EXAGGERATIONS = { min: 0.1, max: 1000 } as const;
export const BACKGROUNDS = ["page", "black", "white"] as const;

/** What is cut away. World units. */
export interface ClipChoice {
  /** What lies beyond the plane is cut away: `normal · p > offset`. The normal is a unit vector. */
  readonly plane?: { readonly normal: Vec3; readonly offset: number } | undefined;
  /** What lies outside is cut away. */
  readonly box?: { readonly min: Vec3; readonly max: Vec3 } | undefined;
  /** Solids are closed at the cut. */
  readonly caps: boolean;
}

/** Planes of samples that are shown. */
export interface SliceChoice {
  /** Which plane across each axis, `null` for none. */
  readonly planes: readonly [number | null, number | null, number | null];
  /** Values that are black and white; without it the range of the field. */
  readonly window?: readonly [number, number] | undefined;
}

/** The volume at a low resolution along the rays of the picture: their maxima, or a cloud. */
export const VOLUME_MODES = ["off", "maximum", "rendering"] as const;

export interface VolumeChoice {
  readonly mode: (typeof VOLUME_MODES)[number];
  readonly opacity: number;
  /** Values that are not seen, and seen best; without it nearly the field's range. */
  readonly window?: readonly [number, number] | undefined;
  /** The field that the window is about; without it that of any surface. */
  readonly windowField?: string | undefined;
  /** Values from the isovalue on have a colour of their own. */
  readonly marksIso: boolean;
}

/** The window if it is about this field: another one has other values. */
export function windowOf({ window, windowField }: VolumeChoice, field: string): VolumeChoice["window"] {
  return windowField === undefined || windowField === field ? window : undefined;
}

export interface Look {
  readonly colorBy: ColorBy;
  /** Of the field, the blended value and the importance. */
  readonly map: (typeof MAPS)[number];
  /** Values of the field that have the first and the last colour; without it the range over which it counts as importance. */
  readonly colorRange?: readonly [number, number] | undefined;
  /** The field's colours are logarithmic. */
  readonly logColors: boolean;
  /** About how many isolines of the field are drawn on the surface. */
  readonly isolines: number;
  readonly material: (typeof MATERIALS)[number];
  /** Each triangle has one light. */
  readonly flat: boolean;
  readonly wireframe: boolean;
  /** Triangles of finer levels are hidden. */
  readonly finestLevel: number;
  readonly background: (typeof BACKGROUNDS)[number];
  /** Crevices are darker. */
  readonly occlusion: boolean;
  /** Dark lines at jumps of the depth. */
  readonly silhouettes: boolean;
  readonly orthographic: boolean;
  /** How many times higher the world is shown than it is. What is measured stays true. */
  readonly exaggeration: number;
  /** What is drawn beside the surface. */
  readonly axes: boolean;
  readonly scale: boolean;
  readonly box: boolean;
  readonly clip: ClipChoice;
  readonly slices: SliceChoice;
  readonly volume: VolumeChoice;
  /** What was measured on the surface, in this order. */
  readonly measures: readonly Measure[];
}

export const NO_CLIP: ClipChoice = { caps: true };
export const NO_SLICES: SliceChoice = { planes: [null, null, null] };

export const NO_VOLUME: VolumeChoice = { mode: "off", opacity: 0.7, marksIso: true };

export const DEFAULT_LOOK: Look = {
  colorBy: "material",
  map: "batlow",
  logColors: false,
  isolines: 0,
  material: "ivory",
  flat: false,
  wireframe: false,
  finestLevel: 0,
  background: "page",
  occlusion: true,
  silhouettes: false,
  orthographic: false,
  exaggeration: 1,
  axes: true,
  scale: true,
  box: false,
  clip: NO_CLIP,
  slices: NO_SLICES,
  volume: NO_VOLUME,
  measures: [],
};

/** How a volume is shown first: in the colours that it brings along, else in one colour, for then none has a meaning yet. */
export function openingLook({ opening }: VolumeInfo): Look {
  return opening?.transferFunction === undefined ? DEFAULT_LOOK : { ...DEFAULT_LOOK, colorBy: "transfer" };
}

/** Position and target of the camera, world units. */
export interface Pose {
  readonly position: Vec3;
  readonly target: Vec3;
}

/** A level that there is. */
export function levelOf(number: number): number {
  return Math.min(LEVELS - 1, Math.max(0, Math.trunc(number) || 0));
}
