/**
 * How finely frames are painted while the camera moves: if they take long, effects, translucent layers and then pixels are given up until
 * it rests. The next move begins with the quality that was sufficient for the last one. Pure, except for its clock.
 */

/** What a frame is painted with. */
export interface Quality {
  readonly effects: boolean;
  /** Of the translucent layers. */
  readonly layers: number;
  /** Of the pixels along each side. */
  readonly pixels: number;
}

export const FULL: Quality = { effects: true, layers: 1, pixels: 1 };
/** From full to coarsest; each is for a renderer for which the one before is too slow. */
const STEPS: readonly Quality[] = [FULL, { effects: false, layers: 0.5, pixels: 1 }, { effects: false, layers: 0.25, pixels: 0.7 }, { effects: false, layers: 0.25, pixels: 0.5 }, { effects: false, layers: 0.25, pixels: 0.35 }];

/** 24 frames a second: below that a turn is seen in steps. */
const SLOW_MS = 42;
/** Twice as fast as it has to be: the step above is likely to be fast enough. */
const FAST_MS = 18;
/** So slow that one frame decides, and that one step is too little. */
const VERY_SLOW_MS = 125;
/** Frames that decide else: one alone may have waited for something. */
const SLOW_FRAMES = 3;
const FAST_FRAMES = 40;
/** A display may limit the rate of frames, so that none is fast: the step above is tried after so long without slow ones. */
const TRIAL_MS = 4000;
/** After each trial that fails, the next one waits twice as long, up to this. */
const MAX_TRIAL_MS = 64_000;
/** The camera rests if it has not moved for so long: a hand that pauses would else see each pause. */
export const REST_MS = 180;

export class AdaptiveQuality {
  private step = 0;
  /** When the last frame began, if the camera moved in it. */
  private moved: number | undefined;
  private slow = 0;
  private fast = 0;
  /** How long frames have not been slow. */
  private steadyMs = 0;
  private trialMs = TRIAL_MS;
  /** The step was raised, and has not held for long yet. */
  private isTrial = false;
  private timer: ReturnType<typeof setTimeout> | undefined;

  /**
   * @param isOn else all frames are painted in full
   * @param onRest the next frame is to be painted in full
   */
  constructor(
    private readonly isOn: boolean,
    private readonly onRest: () => void,
    private readonly now: () => number = () => performance.now(),
  ) {}

  /** For the next frame, whether it is painted or not. @param isMoving the camera has moved since the last one */
  next(isMoving: boolean): Quality {
    if (!this.isOn) return FULL;
    const now = this.now();
    if (isMoving && this.moved !== undefined) this.judge(now - this.moved);
    this.moved = isMoving ? now : undefined;
    if (isMoving) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.rest(), REST_MS);
    }
    return this.timer === undefined ? FULL : this.current;
  }

  private get current(): Quality {
    return STEPS[this.step] ?? FULL;
  }

  /** Frames may take longer than that: the next one tells whether the camera moves still. */
  private rest(): void {
    this.timer = undefined;
    if (this.step > 0) this.onRest();
  }

  private judge(frameMs: number): void {
    if (frameMs > VERY_SLOW_MS) return this.lower(2);
    this.slow = frameMs > SLOW_MS ? this.slow + 1 : 0;
    this.fast = frameMs < FAST_MS ? this.fast + 1 : 0;
    this.steadyMs = frameMs > SLOW_MS ? 0 : this.steadyMs + frameMs;
    if (this.slow >= SLOW_FRAMES) this.lower(1);
    else if (this.fast >= FAST_FRAMES || this.steadyMs >= this.trialMs) this.raise();
  }

  private lower(steps: number): void {
    if (this.isTrial) this.trialMs = Math.min(MAX_TRIAL_MS, 2 * this.trialMs);
    this.isTrial = false;
    this.go(this.step + steps);
  }

  private raise(): void {
    // The step that was tried last has held.
    if (this.isTrial) this.trialMs = TRIAL_MS;
    this.isTrial = this.step > 0;
    this.go(this.step - 1);
  }

  private go(step: number): void {
    this.step = Math.min(STEPS.length - 1, Math.max(0, step));
    [this.slow, this.fast, this.steadyMs] = [0, 0, 0];
  }
}
