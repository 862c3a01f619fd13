/**
 * A story as numbered PNGs in a zip: the frames of each move, and one of each rest. A list beside them says how long each one is shown, as ffmpeg's `concat` reads
 * it. Loaded when it is asked for.
 */

import { imageName, StoredZip } from "../image/zip";
import type { Pose } from "../state/look";
import { FRAMES_PER_SECOND, sharesOf, type StoryFrames, type StoryRecorder } from "./storyFrames";

/** More would fill the browser's memory. */
const MAX_IMAGES = 1500;
const DIGITS = 4;

/** A line of the list. */
export interface TimedImage {
  readonly name: string;
  readonly seconds: number;
}

/** What `ffmpeg -i story.ffconcat` reads. */
export function ffconcat(images: readonly TimedImage[]): string {
  const lines = images.flatMap(({ name, seconds }) => [`file '${name}'`, `duration ${Number(seconds.toFixed(4))}`]);
  // Of the last file the duration counts only if it is named once more.
  const last = images.at(-1);
  return `${["ffconcat version 1.0", ...lines, ...(last === undefined ? [] : [`file '${last.name}'`])].join("\n")}\n`;
}

export class ImagesRecorder implements StoryRecorder {
  private readonly zip = new StoredZip();
  private readonly images: TimedImage[] = [];

  constructor(private readonly frames: StoryFrames) {}

  async pass(seconds: number, at: ((share: number) => Pose) | undefined, caption: string, signal: AbortSignal | undefined): Promise<void> {
    if (at === undefined) return this.add(undefined, caption, seconds);
    for (const share of sharesOf(seconds)) {
      if (signal?.aborted === true) return;
      await this.add(at(share), caption, 1 / FRAMES_PER_SECOND);
    }
  }

  end(): Promise<{ readonly blob: Blob; readonly ending: string }> {
    this.zip.add("story.ffconcat", new TextEncoder().encode(ffconcat(this.images)));
    return Promise.resolve({ blob: this.zip.end(), ending: "zip" });
  }

  cancel(): void {
    this.images.length = 0;
  }

  private async add(pose: Pose | undefined, caption: string, seconds: number): Promise<void> {
    if (this.images.length >= MAX_IMAGES) throw new Error(`it has more than ${MAX_IMAGES} images: save a video, or a story with fewer bookmarks`);
    this.frames.draw(pose, caption);
    const { canvas } = this.frames;
    const png = await new Promise<Blob | null>((done) => canvas.toBlob(done, "image/png"));
    if (png === null) throw new Error("the browser made no PNG of a frame");
    const name = imageName(this.images.length, DIGITS);
    this.zip.add(name, new Uint8Array(await png.arrayBuffer()));
    this.images.push({ name, seconds });
  }
}
