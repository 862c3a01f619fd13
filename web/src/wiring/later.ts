/** Runs something once: for many events, a while after the first of them; or when it is first needed. */
export class Later {
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly delayMs: number,
    private readonly act: () => void,
  ) {}

  soon(): void {
    this.timer ??= setTimeout(this.act, this.delayMs);
  }

  /** It is being done now. */
  done(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
  }
}

/** Calls it when it is first asked for, and gives the same to all who ask. */
export function once<T>(make: () => T): () => T {
  let made: { readonly value: T } | undefined;
  return () => (made ??= { value: make() }).value;
}

let pending: (() => void) | undefined;

/** Calls back when pointer or key is released, for what tells only of moves; of several calls before that the last one counts. */
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
