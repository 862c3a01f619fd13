/** Time steps: which one is asked for, the player, and what is measured over all of them. */

import type { Actions } from "../ui/actions";
import type { Model } from "../ui/model";
import type { Store } from "../state/store";
import type { Questions } from "../questions/questions";
import type { RegionPipeline } from "../regions/pipeline";
import { unevenOf } from "../world/uneven";
import { axesOf } from "./enclosing";
import { Player } from "./player";
import { Stepping } from "./stepping";
import { once } from "./later";
import type { TimeMeasuring } from "./timeMeasuring";

/** Steps that are gone through to measure are no step of the history. */
const GESTURE = "measure-time";

export interface TimelineParts {
  readonly store: Store;
  readonly model: Model;
  readonly pipeline: RegionPipeline;
  readonly questions: Questions;
  readonly isSettled: () => boolean;
  readonly change: (act: () => void) => void;
  readonly open: (volume: string, step: number) => void;
}

export class Timeline {
  readonly stepping: Stepping;
  readonly player: Player;
  private readonly makeMeasuring: () => Promise<TimeMeasuring>;
  private measuring: TimeMeasuring | undefined;

  constructor(parts: TimelineParts) {
    const { store, model, change, isSettled } = parts;
    const isShown = () => isSettled() && !store.viewer.opening;
    this.stepping = new Stepping(store, (volume, step) => parts.open(volume, step));
    this.player = new Player(store, {
      isShown,
      go: (step) => change(() => store.goTo(step, "play")),
      onStop: () => change(() => store.endGesture()),
    });
    this.makeMeasuring = once(async () => new (await import("./timeMeasuring")).TimeMeasuring(store, {
      isShown,
      go: (step) => change(() => store.goTo(step, GESTURE)),
      back: () => change(() => store.cancelGesture(GESTURE)),
      sum: () => {
        const { selected, volume } = store.viewer;
        if (volume === undefined) throw new Error("no volume is open");
        return parts.pipeline.sum(selected, axesOf(volume.geometry), unevenOf(volume.geometry));
      },
      probe: (position) => parts.questions.probeAt(position, store.viewer.selected),
      show: (curves) => model.showCurves(curves),
      fail: (reason) => model.toast(reason),
    }));
    if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) this.player.slow();
  }

  follow(): void {
    this.player.follow();
    this.measuring?.follow();
  }

  readonly measure: Actions["measureOverTime"] = (run) => {
    if (!run) return this.measuring?.stop();
    this.player.stop();
    void this.makeMeasuring().then((measuring) => {
      this.measuring = measuring;
      measuring.start();
    });
  };
}
