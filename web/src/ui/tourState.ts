/** Whether this browser has seen the tour, and the step that the tour is at. It is hidden while the help is open or the user follows. */

import { createSignal } from "solid-js";

const KEY = "isopeel.tour";

export function isTourDue(): boolean {
  try {
    return localStorage.getItem(KEY) === null;
  } catch {
    // If storage is forbidden, the tour is not due: else it would come each time.
    return false;
  }
}

export function endTour(): void {
  try {
    localStorage.setItem(KEY, "seen");
  } catch {
    // Storage may be forbidden.
  }
}

/** Number of the step. */
export const [step, setStep] = createSignal(0);
/** Whether the user has marked a part. */
export const [hasTried, setTried] = createSignal(false);
