/** A part of a slice, larger. Places are pixels of the page from the slice's upper left corner. Pure. */

import { screenOf, type Fit, type SliceView } from "./view";

type Pair = readonly [number, number];

export interface SliceZoom {
  /** Above 1. */
  readonly factor: number;
  /** What is in the middle, in the view's screen coordinates. */
  readonly center: Pair;
}

/** A sample is a square of many pixels by then. */
const MAX_FACTOR = 40;
/** The crosshair stays this far inside, as a share of the size. */
const EDGE = 0.04;

/** @param whole the fit of the whole slice */
export function zoomedFit(whole: Fit, [width, height]: Pair, zoom: SliceZoom | undefined): Fit {
  if (zoom === undefined) return whole;
  const scale = whole.scale * zoom.factor;
  return { scale, left: width / 2 - scale * zoom.center[0], top: height / 2 - scale * zoom.center[1] };
}

/** Larger or smaller by a factor; what is at a place stays there. `undefined`: the whole slice. */
export function zoomedAt(whole: Fit, size: Pair, zoom: SliceZoom | undefined, [x, y]: Pair, by: number): SliceZoom | undefined {
  const now = zoomedFit(whole, size, zoom);
  const factor = Math.min(MAX_FACTOR, (zoom?.factor ?? 1) * by);
  if (!(factor > 1.001)) return undefined;
  const scale = whole.scale * factor;
  return { factor, center: [(x - now.left) / now.scale - (x - size[0] / 2) / scale, (y - now.top) / now.scale - (y - size[1] / 2) / scale] };
}

/** Moved by a number of pixels. */
export function panned(whole: Fit, zoom: SliceZoom | undefined, [right, down]: Pair): SliceZoom | undefined {
  if (zoom === undefined) return undefined;
  const scale = whole.scale * zoom.factor;
  return { ...zoom, center: [zoom.center[0] - right / scale, zoom.center[1] - down / scale] };
}

/** With a sample in sight: as it is, or with that in the middle. */
export function keptInSight(view: SliceView, whole: Fit, size: Pair, zoom: SliceZoom | undefined, i: number, j: number): SliceZoom | undefined {
  if (zoom === undefined) return undefined;
  const fit = zoomedFit(whole, size, zoom);
  const place = screenOf(view, i, j);
  const isInside = [fit.left, fit.top].every((from, axis) => {
    const at = from + fit.scale * (place[axis] ?? 0);
    const length = size[axis] ?? 1;
    return at >= EDGE * length && at <= (1 - EDGE) * length;
  });
  return isInside ? zoom : { ...zoom, center: place };
}
