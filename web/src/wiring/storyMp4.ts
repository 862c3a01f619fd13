/** A story as an MP4 by the browser's encoder, frame by frame: however long a frame takes, the video has its own time. Loaded when it is asked for. */

import { ArrayBufferTarget, Muxer } from "mp4-muxer";
import type { Pose } from "../state/look";
import { BITS_PER_SECOND, FRAMES_PER_SECOND, sharesOf, type StoryFrames, type StoryRecorder } from "./storyFrames";

/** H.264, which all players know, at levels for usual and for large sizes; else what this browser has. */
const CODECS = [
  ["avc1.640028", "avc"],
  ["avc1.640034", "avc"],
  ["avc1.42e028", "avc"],
  ["avc1.42e034", "avc"],
  ["vp09.00.51.08", "vp9"],
  ["av01.0.12M.08", "av1"],
] as const;
/** Of a camera that rests: frames that do not differ. */
const STILLS_PER_SECOND = 5;
/** Frames from one that stands for itself to the next. */
const KEY_EVERY = 50;
/** Frames that the encoder has at a time. */
const MAX_QUEUED = 4;

type Codec = (typeof CODECS)[number];

function configOf([codec]: Codec, { width, height }: HTMLCanvasElement): VideoEncoderConfig {
  return { codec, width, height, bitrate: BITS_PER_SECOND, framerate: FRAMES_PER_SECOND };
}

async function isSupported(codec: Codec, canvas: HTMLCanvasElement): Promise<boolean> {
  const found = await VideoEncoder.isConfigSupported(configOf(codec, canvas)).catch(() => undefined);
  return found?.supported === true;
}

export class Mp4Recorder implements StoryRecorder {
  private readonly muxer: Muxer<ArrayBufferTarget>;
  private readonly encoder: VideoEncoder;
  private fault: Error | undefined;
  private count = 0;
  /** Microseconds. */
  private time = 0;

  private constructor(
    private readonly frames: StoryFrames,
    codec: Codec,
  ) {
    const { width, height } = frames.canvas;
    this.muxer = new Muxer({ target: new ArrayBufferTarget(), video: { codec: codec[1], width, height }, fastStart: "in-memory" });
    this.encoder = new VideoEncoder({ output: (chunk, about) => this.muxer.addVideoChunk(chunk, about), error: (fault) => (this.fault = fault) });
    this.encoder.configure(configOf(codec, frames.canvas));
  }

  /** `undefined` if the browser encodes nothing that an MP4 can have. */
  static async begin(frames: StoryFrames): Promise<Mp4Recorder | undefined> {
    if (typeof VideoEncoder === "undefined") return undefined;
    for (const codec of CODECS) if (await isSupported(codec, frames.canvas)) return new Mp4Recorder(frames, codec);
    return undefined;
  }

  async pass(seconds: number, at: ((share: number) => Pose) | undefined, caption: string, signal: AbortSignal | undefined): Promise<void> {
    if (at === undefined) {
      this.frames.draw(undefined, caption);
      const count = Math.max(1, Math.round(seconds * STILLS_PER_SECOND));
      for (let i = 0; i < count && signal?.aborted !== true; i += 1) await this.encode(seconds / count);
      return;
    }
    const shares = sharesOf(seconds);
    for (const share of shares) {
      if (signal?.aborted === true) return;
      this.frames.draw(at(share), caption);
      await this.encode(seconds / shares.length);
    }
  }

  async end(): Promise<{ readonly blob: Blob; readonly ending: string }> {
    await this.encoder.flush();
    this.check();
    this.encoder.close();
    this.muxer.finalize();
    return { blob: new Blob([this.muxer.target.buffer], { type: "video/mp4" }), ending: "mp4" };
  }

  cancel(): void {
    if (this.encoder.state !== "closed") this.encoder.close();
  }

  private async encode(seconds: number): Promise<void> {
    const { encoder, frames } = this;
    const duration = Math.round(1e6 * seconds);
    const frame = new VideoFrame(frames.canvas, { timestamp: this.time, duration });
    encoder.encode(frame, { keyFrame: this.count % KEY_EVERY === 0 });
    frame.close();
    this.count += 1;
    this.time += duration;
    while (encoder.state === "configured" && encoder.encodeQueueSize > MAX_QUEUED) await new Promise((done) => encoder.addEventListener("dequeue", done, { once: true }));
    // The page goes on.
    await new Promise((done) => setTimeout(done));
    this.check();
  }

  private check(): void {
    if (this.fault !== undefined) throw this.fault;
  }
}
