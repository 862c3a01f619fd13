/** Plays time steps: the next one is asked for when the last is on screen, so that none waits in line. */

import type { PageLayers } from "../state/page";
import type { Store } from "../state/store";
import { nextStep, stepCount } from "../state/timeSteps";

interface PlayerHandlers {
  /** The step that was asked for last is on screen, as a whole. */
  readonly isShown: () => boolean;
  readonly go: (step: number) => void;
  readonly change: (player: PageLayers["player"]) => void;
  readonly onStop: () => void;
}

export class Player {
  private timer: ReturnType<typeof setTimeout> | undefined;
  private askedAt = -Infinity;
  private wasPlaying = false;

  constructor(
    private readonly store: Pick<Store, "page" | "viewer" | "step">,
    private readonly on: PlayerHandlers,
    private readonly now: () => number = () => performance.now(),
  ) {}

  /** Something has changed: settings, or what is on screen. */
  follow(): void {
    const { playing, speed } = this.store.page.player;
    if (playing !== this.wasPlaying) {
      this.wasPlaying = playing;
      if (!playing) this.on.onStop();
    }
    if (!playing) {
      clearTimeout(this.timer);
      this.timer = undefined;
      return;
    }
    if (this.timer !== undefined || !this.on.isShown()) return;
    const wait = Math.max(0, this.askedAt + 1000 / speed - this.now());
    this.timer = setTimeout(() => {
      this.timer = undefined;
      // An edit may have come in between: its surface is shown first.
      if (this.store.page.player.playing && this.on.isShown()) this.advance();
    }, wait);
  }

  /** As the user does with the button. */
  stop(): void {
    const { player } = this.store.page;
    if (!player.playing) return;
    this.on.change({ ...player, playing: false });
    this.follow();
  }

  private advance(): void {
    const { page, step, viewer } = this.store;
    const next = nextStep(step, stepCount(viewer), page.player.loop);
    if (next === undefined) return this.stop();
    this.askedAt = this.now();
    this.on.go(next);
  }
}
