/** What is looked at when the picture is still: it costs as much as a frame of few pixels. */

export class WhenStill {
  private timer: ReturnType<typeof setTimeout> | undefined;

  /** @param stillMs the picture is still if no frame was rendered for this time */
  constructor(
    private readonly stillMs: number,
    private readonly look: () => Promise<void>,
  ) {}

  /** A frame was rendered. @param isWanted there is something to look for */
  lookSoon(isWanted: boolean): void {
    clearTimeout(this.timer);
    if (isWanted) this.timer = setTimeout(() => void this.look(), this.stillMs);
  }
}
