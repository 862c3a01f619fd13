/** A story as a video: frames are composed as images are, one after the other, and the browser's recorder runs only while one is shown. Loaded when it is asked for. */

import { drawImage } from "../image/compose";
import type { SurfaceRenderer } from "../scene/renderer";
import type { Pose } from "../state/look";
import type { Store } from "../state/store";
import type { ImageRequest } from "../ui/actions";
import { imageParts } from "./imageMaker";

const FRAMES_PER_SECOND = 25;
const BITS_PER_SECOND = 8_000_000;
/** What browsers record, the best first. */
const TYPES = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm", "video/mp4"] as const;

export class StoryRecorder {
  private readonly parts: Blob[] = [];

  private constructor(
    private readonly scene: SurfaceRenderer,
    private readonly store: Store,
    private readonly request: ImageRequest,
    private readonly canvas: HTMLCanvasElement,
    private readonly recorder: MediaRecorder,
  ) {
    recorder.addEventListener("dataavailable", ({ data }) => this.parts.push(data));
    recorder.start();
    recorder.pause();
  }

  /** Begins to record; `undefined` if the browser records no video. */
  static begin(scene: SurfaceRenderer, store: Store, request: ImageRequest): StoryRecorder | undefined {
    const type = typeof MediaRecorder === "undefined" ? undefined : TYPES.find((type) => MediaRecorder.isTypeSupported(type));
    if (type === undefined) return undefined;
    const canvas = document.createElement("canvas");
    const { width, height } = scene.size;
    // Coders want even sizes.
    [canvas.width, canvas.height] = [2 * Math.round((width * request.scale) / 2), 2 * Math.round((height * request.scale) / 2)];
    const recorder = new MediaRecorder(canvas.captureStream(), { mimeType: type, videoBitsPerSecond: BITS_PER_SECOND });
    return new StoryRecorder(scene, store, request, canvas, recorder);
  }

  /** @param at the pose at a share of the time; without it the camera rests */
  async pass(seconds: number, at: ((share: number) => Pose) | undefined, caption: string, signal: AbortSignal | undefined): Promise<void> {
    if (at === undefined) {
      this.draw(undefined, caption);
      return this.roll(1000 * seconds, signal);
    }
    const frames = Math.max(1, Math.round(seconds * FRAMES_PER_SECOND));
    for (let i = 1; i <= frames && signal?.aborted !== true; i += 1) {
      this.draw(at(i / frames), caption);
      await this.roll(1000 / FRAMES_PER_SECOND, signal);
    }
  }

  end(): Promise<Blob> {
    return new Promise((done) => {
      this.recorder.addEventListener("stop", () => done(new Blob(this.parts, { type: this.recorder.mimeType })));
      this.recorder.stop();
    });
  }

  private draw(pose: Pose | undefined, caption: string): void {
    const { canvas, request, scene, store } = this;
    const { projection } = scene.camera;
    if (pose !== undefined) scene.camera.restore(pose);
    const snapshot = scene.snapshot({ scale: request.scale, transparent: true, ...(pose === undefined ? {} : { pose: { ...pose, projection } }) });
    const picture = drawImage(snapshot, imageParts(scene, store, { ...request, transparent: false, caption }));
    canvas.getContext("2d")?.drawImage(picture, 0, 0, canvas.width, canvas.height);
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
