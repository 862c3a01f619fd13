/** Shows the crosshair of the slices in the picture beside them. */

import type { SurfaceRenderer } from "../scene/renderer";
import { Throttle } from "../net/throttle";
import type { VolumeInfo } from "../protocol/types";
import { crosshairOf, type Slicing } from "../state/slicing";
import { worldOf, type PlacedGrid, type Triple } from "../world/places";

const withAxis = (index: Triple, axis: number, value: number): Triple => [axis === 0 ? value : index[0], axis === 1 ? value : index[1], axis === 2 ? value : index[2]];

/** Its lines go from the volume's first samples to its last ones. */
export function crosshairPlace(grid: PlacedGrid, at: Triple): { readonly at: Triple; readonly ends: readonly (readonly [Triple, Triple])[] } {
  const end = (axis: number, value: number) => worldOf(grid, withAxis(at, axis, value));
  return { at: worldOf(grid, at), ends: grid.dims.map((count, axis) => [end(axis, 0), end(axis, count - 1)] as const) };
}

/** Minimum interval between frames while the crosshair is dragged: a CPU renders the surface again for each frame, which would delay the slices. */
const INTERVAL_MS = { gpu: 0, processor: 200 } as const;

export class Pointing {
  private shown = "";
  private place: ReturnType<typeof crosshairPlace> | undefined;
  private readonly throttle: Throttle;

  constructor(scene: Pick<SurfaceRenderer, "annotations" | "onGpu">) {
    this.throttle = new Throttle(scene.onGpu ? INTERVAL_MS.gpu : INTERVAL_MS.processor, () => scene.annotations.point(this.place));
  }

  show(slicing: Slicing, volume: VolumeInfo | undefined): void {
    const at = volume === undefined || slicing.layout !== "both" ? undefined : crosshairOf(slicing, volume.geometry.dims);
    // If nothing has changed, no frame is rendered.
    const wanted = at === undefined ? "" : `${volume?.id} ${at.join()}`;
    if (wanted === this.shown) return;
    this.shown = wanted;
    this.place = volume === undefined || at === undefined ? undefined : crosshairPlace(volume.geometry, at);
    this.throttle.call();
  }
}
