/** The curve of the estimated error against triangles: what it says at a place, and as paths. Pure. */

import type { Curve } from "../../protocol/types";
import { SHARE_SCALE } from "../cards/share";

/** Ends of the axis of the error, in voxels. */
const ERRORS = [0.005, 5] as const;
/** The error that is marked on the curve, in voxels: it is hardly visible. */
export const FINE_ERROR = 0.1;

type Points = Curve["points"];

/** How measured errors lie to estimated ones: `factor` times as large, and a further error of all surfaces on the curve. */
export interface Correction {
  readonly factor: number;
  readonly added: number;
}

export const NO_CORRECTION: Correction = { factor: 1, added: 0 };

/**
 * What the measured error of one surface says of the others. An estimate leaves out what the full surface has, whose triangles are no
 * exact isosurface either: squares add up. An estimate that is too large is so by a factor.
 */
export function correctionOf(measured: number, estimated: number): Correction {
  if (!(estimated > 0)) return { factor: 1, added: measured };
  return measured < estimated ? { factor: measured / estimated, added: 0 } : { factor: 1, added: Math.sqrt(measured ** 2 - estimated ** 2) };
}

export function corrected(points: Points, { factor, added }: Correction): Points {
  return points.map((point) => ({ ...point, rms: Math.hypot(factor * point.rms, added) }));
}

/** Position of a number between two others, on a scale whose equal steps are equal factors. */
const between = (low: number, high: number, value: number) => Math.log(value / low) / Math.log(high / low);

/** The error expected of a number of triangles; `undefined` if there is no surface of so few. */
export function errorAt(points: Points, triangles: number): number | undefined {
  const after = points.findIndex((point) => point.triangles <= triangles);
  if (after < 0) return undefined;
  const [fine, coarse] = [points[after - 1], points[after]];
  if (coarse === undefined || fine === undefined) return coarse?.rms;
  const t = between(coarse.triangles, fine.triangles, triangles);
  // The full surface has no error, which has no logarithm.
  if (fine.rms <= 0) return (1 - t) * coarse.rms;
  return coarse.rms * (fine.rms / coarse.rms) ** t;
}

/** The fewest triangles with which the error, or the threshold, is at most this one; `undefined` if the curve does not cross it. */
export function trianglesFor(points: Points, value: number, of: "rms" | "threshold" = "rms"): number | undefined {
  const after = points.findIndex((point) => point[of] > value);
  const [fine, coarse] = [points[after - 1], points[after]];
  if (coarse === undefined || fine === undefined) return undefined;
  const t = fine[of] <= 0 ? value / coarse[of] : between(fine[of], coarse[of], value);
  return fine.triangles * (coarse.triangles / fine.triangles) ** t;
}

export interface Size {
  readonly width: number;
  readonly height: number;
}

/** From the left: a share of the full surface, on the axis of the slider below. */
export const toX = (share: number, { width }: Size): number => SHARE_SCALE.toPosition(share) * width;

/** From the top: an error in voxels. */
export const toY = (error: number, { height }: Size): number => (1 - Math.min(1, Math.max(0, between(ERRORS[0], ERRORS[1], Math.max(error, 1e-9))))) * height;

/** The line, from coarse to fine. */
export function linePath(points: Points, full: number, spacing: number, size: Size): string {
  const places = points.map(({ triangles, rms }) => `${toX(triangles / full, size).toFixed(1)} ${toY(rms / spacing, size).toFixed(1)}`);
  return places.length === 0 ? "" : `M${places.toReversed().join("L")}`;
}

/** Width of a character of a text beside a mark, at most. */
const CHARACTER = 6.5;
const MARGIN = 6;
/** Two lines of text that are nearer meet. */
const LINE = 12;

const widthOf = (text: string) => text.length * CHARACTER + MARGIN;

/** Whether the text of the point at `x` fits to its right. */
export const nowFits = (text: string, x: number, { width }: Size): boolean => x + widthOf(text) < width;

/** Whether the text of the point, at `x` and an error in voxels, is over that of the axis, at the right end of the line of one voxel. */
export function meetsAxisText(axisText: string, text: string, x: number, error: number, size: Size): boolean {
  const end = nowFits(text, x, size) ? x + widthOf(text) : size.width;
  return text !== "" && end > size.width - widthOf(axisText) && Math.abs(toY(error, size) - 4 - toY(1, size)) < LINE;
}

/**
 * On which side of a line at `x` its text is, as an anchor; `undefined` if there is no place for it.
 * @param besides `x` of a line that goes down from the curve, which the text leaves free
 */
export function fineSide(text: string, x: number, besides: number, { width }: Size): "start" | "end" | undefined {
  const own = widthOf(text);
  const isFree = (from: number, to: number) => from >= 0 && to <= width && (besides < from || besides > to);
  if (isFree(x - own, x)) return "end";
  return isFree(x, x + own) ? "start" : undefined;
}
