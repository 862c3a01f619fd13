/** Frames of a story, composed as images are, one after the other. */

import { drawImage } from "../image/compose";
import type { SurfaceRenderer } from "../scene/renderer";
import type { Pose } from "../state/look";
import type { Store } from "../state/store";
import type { ImageRequest } from "../ui/actions";
import { imageParts } from "./imageMaker";

export const FRAMES_PER_SECOND = 25;
export const BITS_PER_SECOND = 8_000_000;

/** What makes a file of a story. */
export interface StoryRecorder {
  /** @param at the pose at a share of the time; without it the camera rests */
  readonly pass: (seconds: number, at: ((share: number) => Pose) | undefined, caption: string, signal: AbortSignal | undefined) => Promise<void>;
  /** The file, and the end of its name. */
  readonly end: () => Promise<{ readonly blob: Blob; readonly ending: string }>;
  /** Nothing more is recorded, and there is no file. */
  readonly cancel: () => void;
}

/** How many frames a move has, and the share of it at each. */
export function sharesOf(seconds: number): readonly number[] {
  const count = Math.max(1, Math.round(seconds * FRAMES_PER_SECOND));
  return Array.from({ length: count }, (_, i) => (i + 1) / count);
}

export class StoryFrames {
  readonly canvas = document.createElement("canvas");

  constructor(
    private readonly scene: SurfaceRenderer,
    private readonly store: Store,
    private readonly request: ImageRequest,
  ) {
    const { width, height } = scene.size;
    // Coders want even sizes.
    [this.canvas.width, this.canvas.height] = [2 * Math.round((width * request.scale) / 2), 2 * Math.round((height * request.scale) / 2)];
  }

  /** Draws the scene. @param pose without it the camera rests */
  draw(pose: Pose | undefined, caption: string): void {
    const { canvas, request, scene, store } = this;
    const { projection } = scene.camera;
    if (pose !== undefined) scene.camera.restore(pose);
    const snapshot = scene.snapshot({ scale: request.scale, transparent: true, ...(pose === undefined ? {} : { pose: { ...pose, projection } }) });
    const picture = drawImage(snapshot, imageParts(scene, store, { ...request, transparent: false, caption }));
    canvas.getContext("2d")?.drawImage(picture, 0, 0, canvas.width, canvas.height);
  }
}
