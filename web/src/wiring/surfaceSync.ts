/** Keeps the stream at the surfaces that the store has: edits what differs, adds and removes. */

import type { StreamClient } from "../net/streamClient";
import type { Edit, View } from "../protocol/types";
import type { RegionPipeline } from "../regions/pipeline";
import { MAX_SURFACES, type SurfaceList } from "../state/surfaceList";
import { difference } from "../state/view";
import { sameImportance } from "../transfer/model";

export class SurfaceSync {
  /** @param wanted returns the view that is requested from the server when these values are in force */
  constructor(
    private readonly client: Pick<StreamClient, "edit" | "numbers" | "remember" | "remove" | "view">,
    private readonly pipeline: Pick<RegionPipeline, "event">,
    private readonly wanted: (view: View) => View,
  ) {}

  /** @param first number of the surface whose budget counts for all */
  follow(surfaces: SurfaceList, first: number): void {
    for (const number of this.client.numbers) {
      if (surfaces.every((surface) => surface.number !== number)) this.remove(number);
    }
    for (const { number, view } of [...surfaces].sort((a, b) => Number(b.number === first) - Number(a.number === first))) this.edit(number, this.wanted(view));
  }

  /** A volume or step is open: removes surfaces from the screen that are no longer in the list, as no later message would do so. */
  opened(surfaces: SurfaceList): void {
    for (let number = 0; number < MAX_SURFACES; number += 1) {
      if (surfaces.every((surface) => surface.number !== number)) this.pipeline.event({ type: "removed", surface: number });
    }
  }

  private remove(number: number): void {
    if (!this.client.remove(number)) this.pipeline.event({ type: "removed", surface: number });
  }

  private edit(number: number, view: View): void {
    const before = this.client.view(number);
    if (before === undefined) {
      this.client.edit(view, number);
      return;
    }
    const edit = difference(before, view);
    if (isNothing(edit)) return;
    if (isColorAlone(edit, before)) this.client.remember(edit, number);
    else this.client.edit(edit, number);
  }
}

const isNothing = (edit: Edit) => Object.keys(edit).length === 0;

/** Colours are looked up in the shader: nothing leaves the browser. */
function isColorAlone(edit: Edit, before: View): boolean {
  const { transferFunction, ...rest } = edit;
  return transferFunction !== undefined && isNothing(rest) && sameImportance(before.transferFunction.points, transferFunction.points);
}
