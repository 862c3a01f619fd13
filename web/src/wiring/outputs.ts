/** What leaves the page: images, saved as files, with a word when they are ready; and what batch jobs make. */

import type { SurfaceRenderer } from "../scene/renderer";
import { volumeName } from "../state/fileNames";
import type { Store } from "../state/store";
import type { ImageRequest } from "../ui/actions";
import type { Model } from "../ui/model";
import { saveFile } from "../ui/takeAlong";
import { BatchJobs } from "./batchJobs";
import type { Cameras } from "./cameras";
import type { Made } from "./imageMaker";

export class Outputs {
  private turn: AbortController | undefined;

  constructor(
    private readonly model: Model,
    private readonly store: Store,
    private readonly scene: SurfaceRenderer,
    private readonly cameras: Cameras,
    base: URL,
  ) {
    model.jobs = new BatchJobs(store, model, base);
  }

  saveImage(request: ImageRequest): void {
    void this.save("png", async () => {
      const { makeImage } = await import("./imageMaker");
      return this.cameras.image(request.scale, (pose) => makeImage(this.scene, this.store, request, pose, this.model.slices()));
    });
  }

  /** Begins a turn, or ends the one that is being made. */
  saveTurn(request: ImageRequest, frames: number): void {
    if (this.turn !== undefined) return this.turn.abort();
    const { model, scene, store } = this;
    const turn = new AbortController();
    this.turn = turn;
    model.turning.set(0);
    void this.save("zip", async () => {
      const { makeTurn } = await import("./imageMaker");
      return makeTurn(scene, store, request, frames, (done) => model.turning.set(done / frames), turn.signal);
    }, turn.signal).finally(() => {
      this.turn = undefined;
      model.turning.set(undefined);
    });
  }

  private async save(ending: string, make: () => Promise<Made>, signal?: AbortSignal): Promise<void> {
    const name = `${volumeName(this.store.viewer.volume)}.${ending}`;
    try {
      const { blob, note } = await make();
      saveFile(name, blob);
      this.model.toast(note === undefined ? `${name} is ready` : `${name} is ready, ${note}`, note === undefined ? "brief" : "lasting");
    } catch (error) {
      // The user ended it.
      if (signal?.aborted === true) return;
      this.model.toast(`${name} could not be made: ${error instanceof Error ? error.message : String(error)}`);
    }
  }
}
