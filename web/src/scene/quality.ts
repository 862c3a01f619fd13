/**
 * Quality of frames while the camera moves: if they take long, effects, translucent layers and then pixels are reduced until it rests. The
 * next move begins with the quality that was fast enough in the last one. Pure, except for its clock.
 */

/** Quality of a frame. */
export interface Quality {
  readonly effects: boolean;
  /** Of the translucent layers. */
  readonly layers: number;
  /** Of the pixels along each side. */
  readonly pixels: number;
}

export const FULL: Quality = { effects: true, layers: 1, pixels: 1 };
/** From full to coarsest; each step is for a renderer for which the previous one is too slow. */
const STEPS: readonly Quality[] = [FULL, { effects: false, layers: 0.5, pixels: 1 }, { effects: false, layers: 0.25, pixels: 0.7 }, { effects: false, layers: 0.25, pixels: 0.5 }, { effects: false, layers: 0.25, pixels: 0.35 }];

/** 24 frames per second: below that a turn is visibly jerky. */
const SLOW_MS = 42;
/** Twice as fast as necessary: the step above is probably fast enough. */
const FAST_MS = 18;
/** So slow that one frame decides, and that one step is not enough. */
const VERY_SLOW_MS = 125;
/** Number of slow frames that decide otherwise: a single one may have been delayed by something else. */
const SLOW_FRAMES = 3;
const FAST_FRAMES = 40;
/** Time without slow frames after which the step above is tried: a display may limit the frame rate, so that no frame counts as fast. */
const TRIAL_MS = 4000;
/** After each trial that fails, the next one waits twice as long, up to this. */
const MAX_TRIAL_MS = 64_000;
/** Time without movement after which the camera rests: shorter pauses of the hand must not be visible. */
export const REST_MS = 180;

export class AdaptiveQuality {
  private step = 0;
  /** When the last frame began, if the camera moved in it. */
  private moved: number | undefined;
  private slow = 0;
  private fast = 0;
  /** Time without slow frames. */
  private steadyMs = 0;
  private trialMs = TRIAL_MS;
  /** Whether the step was raised and has not proven itself yet. */
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

  /** Frames may take longer than the time to rest: the next one shows whether the camera still moves. */
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
    // The last trial was successful.
    if (this.isTrial) this.trialMs = TRIAL_MS;
    this.isTrial = this.step > 0;
    this.go(this.step - 1);
  }

  private go(step: number): void {
    this.step = Math.min(STEPS.length - 1, Math.max(0, step));
    [this.slow, this.fast, this.steadyMs] = [0, 0, 0];
  }
}

/** Pixels of the canvas for one of the page, while the picture is still. */
export const pixelRatio = (): number => Math.min(window.devicePixelRatio, 2);
