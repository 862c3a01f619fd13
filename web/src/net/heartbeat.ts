/** Detects a dead connection: the server promised a heartbeat, and none arrived. */

/** Missed heartbeats after which the connection counts as dead. */
const MISSED = 3;
/** Interval between two checks. */
const LOOK_MS = 500;
/** If a check is later than this, the page itself was suspended, and frames may wait to be read. */
const LATE_MS = 2 * LOOK_MS;

export class Heartbeat {
  private timer: ReturnType<typeof setInterval> | undefined;
  private heardAt = 0;
  private lookedAt = 0;
  private limitMs = Infinity;

  /** @param onDead called with the seconds since the last frame */
  constructor(private readonly onDead: (seconds: number) => void) {}

  /** Any frame came. */
  heard(): void {
    this.heardAt = performance.now();
  }

  /** The next heartbeat comes within this time. */
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
    // Frames that came meanwhile are read before the next check.
    if (isLate || now - this.heardAt < this.limitMs) return;
    this.stop();
    this.onDead(Math.round((now - this.heardAt) / 1000));
  }
}
