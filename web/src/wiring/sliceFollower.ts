/** The slices beside the picture: what the store says is fetched, and the page shows it. */

import { crosshairOf, fieldsOf } from "../state/slicing";
import type { Store } from "../state/store";
import type { Model } from "../ui/model";
import { SlicePlanes } from "./slicePlanes";

export class SliceFollower {
  private readonly planes: SlicePlanes;

  constructor(
    private readonly store: Store,
    model: Model,
    base: URL,
  ) {
    this.planes = new SlicePlanes((slices) => model.beside.show(slices), base);
    model.beside.retry = () => this.planes.retry();
  }

  /** Asks for nothing if all is as before. */
  show(): void {
    const { isEmbedded, page: { slicing }, surfaces, view, viewer } = this.store;
    const { connection, target, volume } = viewer;
    const isShown = slicing.layout !== "picture" && !isEmbedded && view !== undefined && volume !== undefined && target?.volume === volume.id;
    const wanted = isShown
      ? { volume, step: target.step, fields: fieldsOf(slicing, view.field, surfaces), at: crosshairOf(slicing, volume.geometry.dims) }
      : undefined;
    this.planes.show(wanted, connection === "connected");
  }
}
