/** Time steps: which one is asked for, the player, and what is measured over all of them. */

import { Throttle } from "../net/throttle";
import type { StateEvent } from "../state/reduce";
import type { Store } from "../state/store";
import type { Actions } from "../ui/actions";
import type { Model } from "../ui/model";
import type { Questions } from "../questions/questions";
import type { RegionPipeline } from "../regions/pipeline";
import { unevenOf } from "../world/uneven";
import { axesOf } from "./summing";
import { Player } from "./player";
import { once } from "./later";
import type { TimeMeasuring } from "./timeMeasuring";

/** Steps that are gone through to measure are no step of the history. */
const GESTURE = "measure-time";

/** Of a dragged slider the latest step is opened, at most this often: each is read from disk. */
const STEP_INTERVAL_MS = 200;

export interface TimelineParts {
  readonly store: Store;
  readonly model: Model;
  readonly pipeline: RegionPipeline;
  readonly questions: Questions;
  readonly isSettled: () => boolean;
  readonly change: (event: StateEvent) => void;
  readonly open: (volume: string, step: number) => void;
}

export class Timeline {
  private readonly steps: Throttle;
  readonly player: Player;
  private readonly makeMeasuring: () => Promise<TimeMeasuring>;
  private measuring: TimeMeasuring | undefined;

  constructor(parts: TimelineParts) {
    const { store, model, change, isSettled } = parts;
    const isShown = () => isSettled() && !store.viewer.opening;
    this.steps = new Throttle(STEP_INTERVAL_MS, () => {
      const { target, volume } = store.viewer;
      if (target !== undefined && target.volume === volume?.id && target.step !== store.step) parts.open(target.volume, store.step);
    });
    this.player = new Player(store, {
      isShown,
      go: (step) => change({ type: "step", step, gesture: "play" }),
      change: (player) => change({ type: "page", layers: { player } }),
      onStop: () => change({ type: "end-gesture" }),
    });
    this.makeMeasuring = once(async () => new (await import("./timeMeasuring")).TimeMeasuring(store, {
      isShown,
      go: (step) => change({ type: "step", step, gesture: GESTURE }),
      back: () => change({ type: "cancel-gesture", name: GESTURE }),
      sum: () => {
        const { selected, volume } = store.viewer;
        if (volume === undefined) throw new Error("no volume is open");
        return parts.pipeline.sum(selected, axesOf(volume.geometry), unevenOf(volume.geometry));
      },
      probe: (position) => parts.questions.probeAt(position, store.viewer.selected),
      show: (curves) => model.curves.set(curves),
      fail: (reason) => model.toast(reason),
    }));
    // A user who prefers reduced motion gets a slide show, until they choose another speed.
    if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) store.dispatch({ type: "page", layers: { player: { ...store.page.player, speed: 1 } } });
  }

  /** Another step is wanted: opens it soon. */
  openStep(): void {
    this.steps.call();
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
