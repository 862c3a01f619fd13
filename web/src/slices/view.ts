/**
 * How a slice across an axis of the volume lies on screen: which way its axes run, its true proportions, what is at its sides. Screen coordinates are in
 * world units here, to the right and down. Pure.
 */

import { sidesOf, type AxisName } from "../world/axes";
import { alongOf, indexAlong, type PlacedGrid, type Triple } from "../world/places";

type AxisNumber = 0 | 1 | 2;

export interface SliceView {
  /** The axis of the volume across the slice. */
  readonly across: AxisNumber;
  /** `Axial`, or in a frame that is not a patient's `Perpendicular to z`. */
  readonly name: string;
  /** Axes of the volume along the screen's width and height. */
  readonly axes: readonly [AxisNumber, AxisNumber];
  /** −1: indices grow to the left, or upwards. */
  readonly signs: readonly [1 | -1, 1 | -1];
  /** The step of the index across that leads along the world's axis: towards the head. */
  readonly onward: 1 | -1;
  /** Left, right, top and bottom: sides of a patient, or axes of the world. */
  readonly sides: readonly [string, string, string, string];
  /** Cosine and sine of the angle between the two axes: not a right angle if a gantry was tilted. */
  readonly skew: readonly [cosine: number, sine: number];
  /** Left, top, right and bottom of the slice. */
  readonly bounds: readonly [number, number, number, number];
  readonly grid: PlacedGrid;
}

const LETTERS = ["x", "y", "z"] as const;
const ORDERS: readonly Triple[] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/** The axis of the world along which each axis of the volume runs, nearly: no two have the same. */
function worldAxes({ direction }: PlacedGrid): Triple {
  const fits = (order: Triple) => order.reduce((sum, world, axis) => sum + Math.abs(direction[axis]?.[world] ?? 0), 0);
  return ORDERS.reduce((best, order) => (fits(order) > fits(best) + 1e-9 ? order : best));
}

/** Which axis of the world runs to the right and which down, and which way, in the slice across one. */
function screenAxes(world: number, frame: string | undefined, leftIsLeft: boolean): readonly [readonly [number, 1 | -1], readonly [number, 1 | -1]] {
  const isPatient = frame === "LPS" || frame === "RAS";
  const towards = frame === "RAS" ? -1 : 1;
  // As radiologists have it, the patient's left is on the right, and the nose points to the left.
  const right = (isPatient && leftIsLeft ? -towards : towards) as 1 | -1;
  if (world === 0) return [[1, towards], [2, -1]];
  return world === 1 ? [[0, right], [2, -1]] : [[0, right], [1, isPatient ? towards : -1]];
}

function sideName(world: number, sign: 1 | -1, frame: string | undefined): string {
  const axis = `${sign > 0 ? "+" : "-"}${LETTERS[world] ?? ""}` as AxisName;
  return sidesOf(frame)[axis]?.letter ?? axis.replace("-", "−");
}

/**
 * The three slices: across the third axis of the world first.
 * @param leftIsLeft a patient's left is on the left, as neurologists have it
 */
export function sliceViews(grid: PlacedGrid & { readonly frame?: string }, leftIsLeft: boolean): readonly SliceView[] {
  const worlds = worldAxes(grid);
  return [2, 1, 0].map((world) => viewOf(grid, worlds, world, leftIsLeft));
}

function viewOf(grid: PlacedGrid & { readonly frame?: string }, worlds: Triple, world: number, leftIsLeft: boolean): SliceView {
  const { frame } = grid;
  const axisOf = (w: number) => worlds.indexOf(w) as AxisNumber;
  const signOf = (w: number): 1 | -1 => (grid.direction[axisOf(w)][w as AxisNumber] < 0 ? -1 : 1);
  const [[right, rightSign], [down, downSign]] = screenAxes(world, frame, leftIsLeft);
  const axes = [axisOf(right), axisOf(down)] as const;
  const signs = [signOf(right) * rightSign, signOf(down) * downSign] as unknown as SliceView["signs"];
  const side = (w: number, sign: number) => sideName(w, sign as 1 | -1, frame);
  const isPatient = sidesOf(frame)["+x"] !== undefined;
  const view = {
    across: axisOf(world),
    name: isPatient ? (["Sagittal", "Coronal", "Axial"][world] ?? "") : `Perpendicular to ${LETTERS[world] ?? ""}`,
    axes,
    signs,
    onward: signOf(world),
    sides: [side(right, -rightSign), side(right, rightSign), side(down, -downSign), side(down, downSign)] as const,
    skew: skewOf(grid, axes, signs),
    grid,
  };
  return { ...view, bounds: boundsOf(view) };
}

function skewOf({ direction }: PlacedGrid, [right, down]: SliceView["axes"], signs: SliceView["signs"]): SliceView["skew"] {
  const cosine = direction[right].reduce((sum, n, axis) => sum + n * (direction[down][axis] ?? 0), 0) * signs[0] * signs[1];
  // Rounding in a file is no tilt.
  return Math.abs(cosine) < 1e-4 ? [0, 1] : [cosine, Math.sqrt(1 - cosine * cosine)];
}

/** To the outer sides of the samples at the ends. */
function boundsOf(view: Omit<SliceView, "bounds">): SliceView["bounds"] {
  const ends = view.axes.map((axis) => [-0.5, view.grid.dims[axis] - 0.5]);
  const corners = (ends[0] ?? []).flatMap((i) => (ends[1] ?? []).map((j) => screenOf(view, i, j)));
  const [xs, ys] = [corners.map(([x]) => x), corners.map(([, y]) => y)];
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

/** Position on screen of indices along the view's two axes. */
export function screenOf({ axes, signs, skew, grid }: Omit<SliceView, "bounds">, i: number, j: number): readonly [number, number] {
  const x = signs[0] * alongOf(grid, axes[0], i);
  const y = signs[1] * alongOf(grid, axes[1], j);
  return [x + skew[0] * y, skew[1] * y];
}

/** Indices along the view's two axes at a place on screen; they may be outside. */
export function indicesAt({ axes, signs, skew, grid }: SliceView, x: number, y: number): readonly [number, number] {
  const along = y / skew[1];
  return [indexAlong(grid, axes[0], signs[0] * (x - skew[0] * along)), indexAlong(grid, axes[1], signs[1] * along)];
}

/** How a view is fitted into a rectangle of pixels: pixels for a world unit, and the pixel of the screen's origin. */
export interface Fit {
  readonly scale: number;
  readonly left: number;
  readonly top: number;
}

export function fitInto({ bounds: [left, top, right, bottom] }: SliceView, width: number, height: number, margin: number): Fit {
  const scale = Math.max(1e-12, Math.min((width - 2 * margin) / (right - left), (height - 2 * margin) / (bottom - top)));
  return { scale, left: width / 2 - (scale * (left + right)) / 2, top: height / 2 - (scale * (top + bottom)) / 2 };
}

export const pixelOf = (view: SliceView, fit: Fit, i: number, j: number): readonly [number, number] => {
  const [x, y] = screenOf(view, i, j);
  return [fit.left + fit.scale * x, fit.top + fit.scale * y];
};

export const indicesAtPixel = (view: SliceView, fit: Fit, x: number, y: number): readonly [number, number] =>
  indicesAt(view, (x - fit.left) / fit.scale, (y - fit.top) / fit.scale);
