/** A dragged time slider: of many steps the latest is opened. */

import { Throttle } from "../net/throttle";
import type { Store } from "../state/store";

/** A step is opened at most this often: each is read from disk. */
const INTERVAL_MS = 200;

export class Stepping {
  private wanted = 0;
  private readonly throttle = new Throttle(INTERVAL_MS, () => {
    const { target } = this.store.viewer;
    if (target !== undefined && target.step !== this.wanted) this.open(target.volume, this.wanted);
  });

  constructor(
    private readonly store: Pick<Store, "viewer">,
    private readonly open: (volume: string, step: number) => void,
  ) {}

  want(step: number): void {
    this.wanted = step;
    this.throttle.call();
  }

  /** Another volume is opened. */
  cancel(): void {
    this.throttle.cancel();
  }
}
