/** Notices a line that is cut without a word: the server promised a sign of life, and nothing came. */

/** Promised signs that are missed until the line counts as dead. */
const MISSED = 3;
/** Between two looks. */
const LOOK_MS = 500;
/** A look that comes later than this says that the page itself stood still, and frames may wait to be read. */
const LATE_MS = 2 * LOOK_MS;

export class Heartbeat {
  private timer: ReturnType<typeof setInterval> | undefined;
  private heardAt = 0;
  private lookedAt = 0;
  private limitMs = Infinity;

  /** @param onDead called with the seconds since anything was heard */
  constructor(private readonly onDead: (seconds: number) => void) {}

  /** Any frame came. */
  heard(): void {
    this.heardAt = performance.now();
  }

  /** The next sign of life comes within this time. */
  promised(seconds: number): void {
    this.limitMs = MISSED * 1000 * seconds;
    this.lookedAt = performance.now();
    this.timer ??= setInterval(() => this.look(), LOOK_MS);
  }

  stop(): void {
    clearInterval(this.timer);
    this.timer = undefined;
    this.limitMs = Infinity;
  }

  private look(): void {
    const now = performance.now();
    const isLate = now - this.lookedAt > LATE_MS;
    this.lookedAt = now;
    // Frames that came meanwhile are read before the next look.
    if (isLate || now - this.heardAt < this.limitMs) return;
    this.stop();
    this.onDead(Math.round((now - this.heardAt) / 1000));
  }
}
