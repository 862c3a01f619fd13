/** What is done once for many events, a while after the first of them. */
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
