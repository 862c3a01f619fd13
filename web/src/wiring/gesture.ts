/** The end of a drag, or of a key that is held, on something that tells only of the moves. */

let pending: (() => void) | undefined;

/** Calls back when pointer or key is released; of several calls before that the last one counts. */
export function whenReleased(act: () => void): void {
  const isWaiting = pending !== undefined;
  pending = act;
  if (isWaiting) return;
  const events = ["pointerup", "pointercancel", "keyup"] as const;
  const end = () => {
    for (const type of events) window.removeEventListener(type, end);
    const last = pending;
    pending = undefined;
    last?.();
  };
  for (const type of events) window.addEventListener(type, end);
}
