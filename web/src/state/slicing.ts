/** Slices beside the picture: which are shown, and the place of their crosshair. Pure. */

import type { Plane } from "../net/slices";
import type { Vec3, VolumeInfo } from "../protocol/types";
import { LinkError, type Reader } from "./linkReader";
import type { SliceChoice } from "./look";
import { readMask } from "./mask";
import type { SurfaceList } from "./surfaceList";

/** The surface alone, with slices beside it, or these alone. */
const LAYOUTS = ["picture", "both", "slices"] as const;
export type Layout = (typeof LAYOUTS)[number];

export interface Slicing {
  readonly layout: Layout;
  /** The sample at which the three slices cross, by its indices; `undefined`: in the middle. */
  readonly at: Vec3 | undefined;
  /** Field that the slices show; `undefined`: that of the selected surface. */
  readonly field: string | undefined;
  /** A patient's left is on the left, as neurologists have it; else on the right, as radiologists do. */
  readonly leftIsLeft: boolean;
}

export const FIRST_SLICING: Slicing = { layout: "picture", at: undefined, field: undefined, leftIsLeft: false };

/** What there is of the slice across one axis. */
export interface SliceState {
  /** Samples of each field, of the slice at `index`; none before the first has come. */
  readonly loaded: LoadedSlice | undefined;
  /** It is the slice that is asked for. */
  readonly isCurrent: boolean;
  /** Why that one is not there, for the user. */
  readonly problem: string | undefined;
}

export interface LoadedSlice {
  readonly index: number;
  readonly planes: ReadonlyMap<string, Plane>;
}

type Dims = VolumeInfo["geometry"]["dims"];

/** The nearest sample that there is. */
export function sampleNear(dims: Dims, index: Vec3): Vec3 {
  const inside = (axis: 0 | 1 | 2) => Math.min(dims[axis] - 1, Math.max(0, Math.round(index[axis])));
  return [inside(0), inside(1), inside(2)];
}

export function crosshairOf({ at }: Pick<Slicing, "at">, dims: Dims): Vec3 {
  return sampleNear(dims, at ?? [(dims[0] - 1) / 2, (dims[1] - 1) / 2, (dims[2] - 1) / 2]);
}

/** The crosshair at a sample, or as near as there are samples. It is the same object if nothing changes. */
export function pointed(slicing: Slicing, dims: Dims, index: Vec3): Slicing {
  const at = sampleNear(dims, index);
  return slicing.at !== undefined && at.every((n, axis) => n === slicing.at?.[axis]) ? slicing : { ...slicing, at };
}

/** Moves the crosshair by `by` samples along an axis. */
export function moved(slicing: Slicing, dims: Dims, axis: 0 | 1 | 2, by: number): Slicing {
  const at = crosshairOf(slicing, dims);
  return pointed(slicing, dims, [at[0] + (axis === 0 ? by : 0), at[1] + (axis === 1 ? by : 0), at[2] + (axis === 2 ? by : 0)]);
}

/** The next layout, for a key. */
export function nextLayout({ layout }: Slicing): Layout {
  return LAYOUTS[(LAYOUTS.indexOf(layout) + 1) % LAYOUTS.length] ?? "picture";
}

/** Moves slices in the picture to the crosshair, while there is one. */
export function planesAt(planes: SliceChoice["planes"], slicing: Slicing, dims: Dims): SliceChoice["planes"] {
  if (slicing.layout === "picture") return planes;
  const at = crosshairOf(slicing, dims);
  const place = (axis: 0 | 1 | 2) => (planes[axis] === null ? null : at[axis]);
  return [place(0), place(1), place(2)];
}

/** The outline of a surface: samples of a field at a value, within a mask. */
export interface Outline {
  readonly surface: number;
  readonly field: string;
  readonly iso: number;
  readonly mask: ReturnType<typeof readMask>;
  /** `#rrggbb`; `undefined`: the surface has the colours of the look. */
  readonly color: string | undefined;
}

/** Of the surfaces that are shown. */
export function outlinesOf(surfaces: SurfaceList): readonly Outline[] {
  return surfaces
    .filter(({ style }) => style.visible)
    .map(({ number, view, style }) => ({ surface: number, field: view.field, iso: view.iso, mask: view.mask === null ? undefined : readMask(view.mask), color: style.color }));
}

/** The field that the slices show, then those that outlines need. */
export function fieldsOf(slicing: Slicing, shown: string, surfaces: SurfaceList): readonly string[] {
  const outlines = outlinesOf(surfaces).flatMap(({ field, mask }) => (mask === undefined ? [field] : [field, mask.field]));
  return [...new Set([slicing.field ?? shown, ...outlines])];
}

/** Names in a link, with the values of those that are in this one. */
export function slicingParts({ layout, at, field, leftIsLeft }: Slicing = FIRST_SLICING): (readonly [string, string | undefined])[] {
  const isShown = layout !== "picture";
  return [
    ["layout", isShown ? layout : undefined],
    ["crosshair", isShown ? at?.join(",") : undefined],
    ["slicefield", field],
    ["left", isShown && leftIsLeft ? "left" : undefined],
  ];
}

/** `undefined`: the link has none of it. @throws LinkError naming what was wrong */
export function readSlicing(read: Reader): Slicing | undefined {
  const [layout, at, field, left] = [read.text("layout"), read.numbers("crosshair", 3), read.text("slicefield"), read.text("left")];
  if ([layout, at, field, left].every((one) => one === undefined)) return undefined;
  const known = LAYOUTS.find((one) => one === (layout ?? "picture"));
  if (known === undefined) throw new LinkError(`This link's “layout” is ${JSON.stringify(layout)}, expected one of ${LAYOUTS.join(", ")}`);
  if (left !== undefined && left !== "left" && left !== "right") throw new LinkError(`This link's “left” is ${JSON.stringify(left)}, expected left or right`);
  const whole = (axis: number) => Math.max(0, Math.round(at?.[axis] ?? 0));
  return { layout: known, at: at && [whole(0), whole(1), whole(2)], field, leftIsLeft: left === "left" };
}
