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
