/** Control points of a transfer function. Pure: every operation returns a new, sorted list. */

import { MAX_POINTS } from "../protocol/generated";
import type { ControlPoint, TransferFunction } from "../protocol/types";

export type Points = readonly ControlPoint[];

/** The paper's default: importance equals the blended feature. */
export const IDENTITY: Points = [
  { x: 0, importance: 0, color: "#3465a4" },
  { x: 1, importance: 1, color: "#f57900" },
];

const clamp01 = (value: number) => Math.min(1, Math.max(0, value));

/** Sorted by x; of two at one x the earlier is the left side of a step. */
export function sorted(points: Points): Points {
  return [...points].sort((a, b) => a.x - b.x);
}

export interface Rgb {
  readonly r: number;
  readonly g: number;
  readonly b: number;
}

/** `#rrggbb` as 0 to 255 each; anything else is black. */
export function parseColor(color: string): Rgb {
  const match = /^#([0-9a-f]{6})$/i.exec(color);
  const value = match?.[1] === undefined ? 0 : parseInt(match[1], 16);
  return { r: value >> 16, g: (value >> 8) & 255, b: value & 255 };
}

/** Red, green and blue as light, 0 to 1. */
export function linearColor(color: string): [number, number, number] {
  const linear = (byte: number) => (byte <= 10 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4);
  const { r, g, b } = parseColor(color);
  return [linear(r), linear(g), linear(b)];
}

export function formatColor({ r, g, b }: Rgb): string {
  const value = (Math.round(r) << 16) | (Math.round(g) << 8) | Math.round(b);
  return `#${value.toString(16).padStart(6, "0")}`;
}

export interface TransferValue {
  readonly importance: number;
  readonly color: Rgb;
}

/** Importance and colour at x: linear between points, constant beyond the ends, at a step its right side. */
export function evaluate(points: Points, x: number): TransferValue {
  let right = 0;
  while (right < points.length && (points[right]?.x ?? Infinity) <= x) right += 1;
  const a = points[right - 1] ?? points[right];
  const b = points[right] ?? a;
  if (a === undefined || b === undefined) return { importance: 0, color: { r: 0, g: 0, b: 0 } };
  const t = b.x > a.x ? clamp01((x - a.x) / (b.x - a.x)) : 0;
  const mix = (from: number, to: number) => from + (to - from) * t;
  const [from, to] = [parseColor(a.color), parseColor(b.color)];
  return {
    importance: mix(a.importance, b.importance),
    color: { r: mix(from.r, to.r), g: mix(from.g, to.g), b: mix(from.b, to.b) },
  };
}

/** Adds a point in the colour at x. Returns the list and the new point's index; a full list is returned as it is. */
export function addPoint(points: Points, x: number, importance: number): { points: Points; index: number } {
  if (points.length >= MAX_POINTS) return { points, index: points.length - 1 };
  const at = clamp01(x);
  const index = points.filter((p) => p.x <= at).length;
  const point = { x: at, importance: clamp01(importance), color: formatColor(evaluate(points, at).color) };
  return { points: points.toSpliced(index, 0, point), index };
}

/** Removes a point, but not the last one: a transfer function has one or more. */
export function removePoint(points: Points, index: number): Points {
  return points.length > 1 ? points.toSpliced(index, 1) : points;
}

/** Moves a point, but not past its neighbours, so that it keeps its index. */
export function movePoint(points: Points, index: number, x: number, importance: number): Points {
  const point = points[index];
  if (point === undefined) return points;
  const low = points[index - 1]?.x ?? 0;
  const high = points[index + 1]?.x ?? 1;
  return points.with(index, {
    ...point,
    x: Math.min(high, Math.max(low, clamp01(x))),
    importance: clamp01(importance),
  });
}

export function recolorPoint(points: Points, index: number, color: string): Points {
  const point = points[index];
  return point === undefined ? points : points.with(index, { ...point, color });
}

/** For a message: numbers rounded to five decimals. */
export function toWire(points: Points): TransferFunction {
  const round = (value: number) => Math.round(value * 1e5) / 1e5;
  return { points: points.map((p) => ({ x: round(p.x), importance: round(p.importance), color: p.color })) };
}
