/** What the page knows of the slices beside the picture. */

import { createSignal } from "solid-js";
import type { SliceState } from "../../state/slicing";

export class SlicesBeside {
  private readonly signal = createSignal<readonly SliceState[]>([]);
  /** Asks again for slices that are not there. Set before the page is shown. */
  retry: (() => void) | undefined;

  /** By the axes across them. */
  get slices(): readonly SliceState[] {
    return this.signal[0]();
  }

  show(slices: readonly SliceState[]): void {
    this.signal[1](slices);
  }
}
