/** A story as a video by the browser's recorder, which runs only while a frame is shown. Loaded when it is asked for. */

import type { Pose } from "../state/look";
import { BITS_PER_SECOND, FRAMES_PER_SECOND, sharesOf, type StoryFrames, type StoryRecorder } from "./storyFrames";

/** What browsers record, the best first. */
const TYPES = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm", "video/mp4"] as const;

export class WebmRecorder implements StoryRecorder {
  private readonly parts: Blob[] = [];

  private constructor(
    private readonly frames: StoryFrames,
    private readonly recorder: MediaRecorder,
  ) {
    recorder.addEventListener("dataavailable", ({ data }) => this.parts.push(data));
    recorder.start();
    recorder.pause();
  }

  /** Begins to record; `undefined` if the browser records no video. */
  static begin(frames: StoryFrames): WebmRecorder | undefined {
    const type = typeof MediaRecorder === "undefined" ? undefined : TYPES.find((type) => MediaRecorder.isTypeSupported(type));
    if (type === undefined) return undefined;
    return new WebmRecorder(frames, new MediaRecorder(frames.canvas.captureStream(), { mimeType: type, videoBitsPerSecond: BITS_PER_SECOND }));
  }

  async pass(seconds: number, at: ((share: number) => Pose) | undefined, caption: string, signal: AbortSignal | undefined): Promise<void> {
    if (at === undefined) {
      this.frames.draw(undefined, caption);
      return this.roll(1000 * seconds, signal);
    }
    for (const share of sharesOf(seconds)) {
      if (signal?.aborted === true) return;
      this.frames.draw(at(share), caption);
      await this.roll(1000 / FRAMES_PER_SECOND, signal);
    }
  }

  end(): Promise<{ readonly blob: Blob; readonly ending: string }> {
    const { parts, recorder } = this;
    return new Promise((done) => {
      recorder.addEventListener("stop", () => done({ blob: new Blob(parts, { type: recorder.mimeType }), ending: recorder.mimeType.includes("mp4") ? "mp4" : "webm" }));
      recorder.stop();
    });
  }

  cancel(): void {
    // The browser may have ended it.
    if (this.recorder.state !== "inactive") this.recorder.stop();
  }

  /** Records what is drawn for this long. */
  private roll(ms: number, signal: AbortSignal | undefined): Promise<void> {
    this.recorder.resume();
    return new Promise((done) => {
      const timer = setTimeout(end, ms);
      const { recorder } = this;
      function end() {
        clearTimeout(timer);
        recorder.pause();
        done();
      }
      signal?.addEventListener("abort", end, { once: true });
    });
  }
}
