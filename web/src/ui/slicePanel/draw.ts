/** Draws a slice and its outlines on a canvas. */

import { contourOf, maskedBy } from "../../slices/contours";
import { paintSlice, type PlaneSamples } from "../../slices/paint";
import { fitInto, pixelOf, type Fit, type SliceView } from "../../slices/view";
import type { FieldInfo } from "../../protocol/types";
import { listHas, type Mask } from "../../state/mask";
import type { LoadedSlice, Outline } from "../../state/slicing";

/** Pixels of the page around a slice: letters stand there. */
const MARGIN = 15;
/** A processor paints: larger pictures are drawn with fewer pixels. */
const MAX_PIXELS = 1.5e6;
const LINE = 1.6;
/** Of surfaces that have the colours of the look: near that of ivory, and seen on grey. */
export const OUTLINE = "#ffd36b";

export interface Drawing {
  readonly view: SliceView;
  readonly loaded: LoadedSlice;
  /** Field that is shown. */
  readonly field: string;
  readonly window: readonly [number, number];
  readonly isSmooth: boolean;
  readonly outlines: readonly DrawnOutline[];
}

export interface DrawnOutline {
  readonly color: string;
  /** Ends of segments, in samples along the lower and the higher axis of the plane. */
  readonly segments: Float32Array;
}

/** In pixels of the page. */
export function fitOf(view: SliceView, width: number, height: number): Fit {
  return fitInto(view, width, height, Math.min(MARGIN, width / 8, height / 8));
}

function holds({ comparison, values }: Mask, value: number): boolean {
  if (Number.isNaN(value)) return false;
  const number = Number(values);
  switch (comparison) {
    case "==":
      return listHas(values, value);
    case "!=":
      return !listHas(values, value);
    case ">=":
      return value >= number;
    case "<=":
      return value <= number;
    case ">":
      return value > number;
    case "<":
      return value < number;
  }
}

/** The numbers in the file of labels that have others here, by which masks call them. */
function numbersOf(field: FieldInfo | undefined): ReadonlyMap<number, number> {
  return new Map((field?.labels ?? []).flatMap(({ value, stored }) => (stored === undefined ? [] : [[value, Number(stored)] as const])));
}

/** The outline of a surface in a slice; none while samples that it needs are not there; `undefined` if it is too fine to be drawn. */
export function outlineIn({ planes }: LoadedSlice, { field, iso, mask }: Outline, fields: readonly FieldInfo[]): Float32Array | undefined {
  const plane = planes.get(field);
  const other = mask && planes.get(mask.field);
  if (plane === undefined || (mask !== undefined && other === undefined)) return new Float32Array();
  if (mask === undefined || other === undefined) return contourOf(plane.samples, plane.size, iso);
  const numbers = numbersOf(fields.find(({ name }) => name === mask.field));
  const samples = maskedBy(plane.samples, other.samples, (value) => holds(mask, numbers.get(value) ?? value));
  return contourOf(samples, plane.size, iso);
}

/** @param scale pixels of the canvas for one of the page  @param onPage place of the slice, pixels of the page */
export function drawSlice(canvas: HTMLCanvasElement, width: number, height: number, scale: number, drawing: Drawing | undefined, onPage: Fit): void {
  const density = Math.min(scale, Math.sqrt(MAX_PIXELS / (width * height)));
  const [w, h] = [Math.max(1, Math.round(width * density)), Math.max(1, Math.round(height * density))];
  if (canvas.width !== w) canvas.width = w;
  if (canvas.height !== h) canvas.height = h;
  // Pixels come from the processor: a canvas of the GPU would take them over and back.
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const plane = drawing?.loaded.planes.get(drawing.field);
  if (context === null) return;
  if (drawing === undefined || plane === undefined) return context.clearRect(0, 0, w, h);
  const fit = { scale: onPage.scale * density, left: onPage.left * density, top: onPage.top * density };
  const image = context.createImageData(w, h);
  paintSlice({ width: w, height: h, pixels: image.data }, drawing.view, plane satisfies PlaneSamples, fit, drawing.window, drawing.isSmooth);
  context.putImageData(image, 0, 0);
  for (const outline of drawing.outlines) strokeOutline(context, drawing.view, fit, density, outline);
}

/** With a dark edge, so that it is seen on white too. */
function strokeOutline(context: CanvasRenderingContext2D, view: SliceView, fit: Fit, density: number, { color, segments }: DrawnOutline): void {
  const path = new Path2D();
  const isTurned = view.axes[0] > view.axes[1];
  const place = (at: number) => {
    const [low, high] = [segments[at] ?? 0, segments[at + 1] ?? 0];
    return isTurned ? pixelOf(view, fit, high, low) : pixelOf(view, fit, low, high);
  };
  for (let at = 0; at < segments.length; at += 4) {
    path.moveTo(...place(at));
    path.lineTo(...place(at + 2));
  }
  context.lineCap = "round";
  for (const [style, lineWidth] of [["rgb(0 0 0 / 0.55)", LINE + 1.6], [color, LINE]] as const) {
    context.strokeStyle = style;
    context.lineWidth = lineWidth * density;
    context.stroke(path);
  }
}
