/** A turn around the surface as numbered PNGs in a zip. Loaded when it is requested. */

import type { CameraPose } from "../scene/pose";
import type { Snapshot } from "../scene/snapshot";
import { composeImage, type ImageParts } from "./compose";
import { imageName, StoredZip } from "./zip";

export interface TurntableRequest {
  /** Pictures of a whole turn. */
  readonly frames: number;
  /** First pose of the turn; it goes around the world's third axis through the target. */
  readonly from: CameraPose;
  readonly parts: ImageParts;
  /** Pictures made so far. */
  readonly onProgress?: (done: number) => void;
  readonly signal?: AbortSignal;
}

/** A turn of some seconds; more would fill the browser's memory. */
export const MAX_FRAMES = 720;

/** The pose of picture `i` of `count`: turned to the left, so that the surface seems to turn to the right. */
export function turnedPose({ position, target, projection }: CameraPose, i: number, count: number): CameraPose {
  const angle = (-2 * Math.PI * i) / count;
  const [x, y] = [position[0] - target[0], position[1] - target[1]];
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return { position: [target[0] + x * cos - y * sin, target[1] + x * sin + y * cos, position[2]], target, projection };
}

/**
 * @param snapshot takes one picture; the page can do other things between two of them
 * @throws when the number of pictures is absurd, or the signal ends it
 */
export async function makeTurntable(snapshot: (pose: CameraPose) => Snapshot, request: TurntableRequest): Promise<Blob> {
  const { frames, from, parts, onProgress, signal } = request;
  if (!Number.isInteger(frames) || frames < 1 || frames > MAX_FRAMES) {
    throw new Error(`a turn of ${frames} pictures, expected 1 to ${MAX_FRAMES}`);
  }
  const zip = new StoredZip();
  const digits = String(frames - 1).length;
  for (let i = 0; i < frames; i += 1) {
    signal?.throwIfAborted();
    const png = await composeImage(snapshot(turnedPose(from, i, frames)), parts);
    zip.add(imageName(i, digits), new Uint8Array(await png.arrayBuffer()));
    onProgress?.(i + 1);
  }
  return zip.end();
}
