/** Sums up area and volume of the selected surface when the user asks, and forgets them when another surface is shown. */

import type { RegionPipeline } from "../regions/pipeline";
import type { Vec3, VolumeInfo } from "../protocol/types";
import { enclosedOf } from "../state/enclosed";
import type { Store } from "../state/store";
import type { ShownPrefix } from "../state/surfaceState";
import type { Model } from "../ui/model";
import { unevenOf } from "../world/uneven";

/** World vectors of one step along each axis of the even grid. */
export function axesOf({ direction, spacing }: Pick<VolumeInfo["geometry"], "direction" | "spacing">): [Vec3, Vec3, Vec3] {
  const step = (axis: 0 | 1 | 2): Vec3 => [direction[axis][0] * spacing[axis], direction[axis][1] * spacing[axis], direction[axis][2] * spacing[axis]];
  return [step(0), step(1), step(2)];
}

export class Enclosing {
  /** What is on screen of the surface that is summed up: a further object with each change. */
  private of: ShownPrefix | undefined;

  constructor(
    private readonly store: Pick<Store, "viewer">,
    private readonly model: Pick<Model, "showEnclosed" | "toast">,
    private readonly pipeline: Pick<RegionPipeline, "sum">,
  ) {}

  async sum(): Promise<void> {
    const { shown, selected, volume } = this.store.viewer;
    if (shown === undefined || volume === undefined) return;
    this.of = shown;
    this.model.showEnclosed("summing");
    const isOfNow = () => this.of === shown && this.store.viewer.shown === shown;
    try {
      const sums = await this.pipeline.sum(selected, axesOf(volume.geometry), unevenOf(volume.geometry));
      if (isOfNow()) this.model.showEnclosed(enclosedOf(sums));
    } catch (error) {
      if (!isOfNow()) return;
      this.of = undefined;
      this.model.showEnclosed(undefined);
      this.model.toast(`Area and volume could not be summed up: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  /** Something may have changed. A better surface of the same values is summed up in its turn. */
  follow(): void {
    const { of } = this;
    const { shown } = this.store.viewer;
    if (of === undefined || of === shown) return;
    if (shown?.generation === of.generation) return void this.sum();
    this.of = undefined;
    this.model.showEnclosed(undefined);
  }
}
