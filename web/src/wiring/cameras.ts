/** Keeps the server at the camera of the page, so that surfaces are finer where the user looks. */

import type { StreamClient } from "../net/streamClient";
import { Throttle } from "../net/throttle";
import { isEqual } from "../protocol/equal";
import type { ViewCamera } from "../protocol/types";
import { followsCamera } from "../protocol/view";
import type { CameraPose } from "../scene/pose";
import type { SurfaceRenderer } from "../scene/renderer";
import { wantedOf } from "../state/state";
import type { Store } from "../state/store";
import { isCameraAwaited, isWorking } from "../state/viewer";
import type { Framing } from "./framing";

/** Minimum interval between two cameras that are sent. */
const INTERVAL_MS = 1000 / 30;
/** The camera is still if it has not moved for this time. */
const STILL_MS = 300;
/** Maximum time to wait for the surfaces of a camera. */
const WAIT_MS = 10_000;
const POLL_MS = 50;

interface CameraParts {
  readonly store: Pick<Store, "dispatch" | "state" | "viewer">;
  readonly scene: { readonly camera: Pick<SurfaceRenderer["camera"], "pose" | "sight"> } & Pick<SurfaceRenderer, "size">;
  /** Pixels of the canvas for one of the page. */
  readonly pixelRatio: () => number;
  readonly framing: Pick<Framing, "pose">;
  readonly client: Pick<StreamClient, "isNewCamera" | "sendCamera">;
  /** Whether the camera is that of the member in control. */
  readonly isLed: () => boolean;
  /** Whether the surfaces for the camera that was sent last are on screen. */
  readonly isSettled: () => boolean;
  /** The camera is still. */
  readonly onStill: () => void;
}

/** The camera of a picture, `scale` pixels for one of the page. */
export function pictureCamera({ camera, size }: CameraParts["scene"], pose: CameraPose, scale: number): ViewCamera {
  const pixels = (length: number) => Math.max(1, Math.round(scale * length));
  return { ...camera.sight(pose), viewport: [pixels(size.width), pixels(size.height)] };
}

export class Cameras {
  private readonly throttle = new Throttle(INTERVAL_MS, () => this.send());
  /** Camera of the page when it was looked at last. */
  private last: ViewCamera | undefined;
  private movedAt = -Infinity;
  private stillTimer: ReturnType<typeof setTimeout> | undefined;
  private waitTimer: ReturnType<typeof setTimeout> | undefined;
  /** Camera of an image that is being made. */
  private ofImage: ViewCamera | undefined;
  private images: Promise<unknown> = Promise.resolve();

  constructor(private readonly parts: CameraParts) {}

  /** Camera of the picture on screen; `undefined` while there is nothing to look at. */
  get onScreen(): ViewCamera | undefined {
    const { framing, pixelRatio, scene } = this.parts;
    return framing.pose === undefined ? undefined : pictureCamera(scene, scene.camera.pose, pixelRatio());
  }

  /** Whether the server has to be told the camera. */
  get isDue(): boolean {
    const { wanted } = this;
    return wanted !== undefined && this.followers.length > 0 && this.parts.client.isNewCamera(wanted);
  }

  /** Whether the camera has rested for a while, and surfaces are made for it. */
  get isStill(): boolean {
    return performance.now() - this.movedAt >= STILL_MS && !this.isDue && !isCameraAwaited(this.parts.store.viewer);
  }

  /** Something may have changed: the camera, or what the server is doing. */
  changed(): void {
    const { onScreen } = this;
    if (!isEqual(onScreen, this.last)) {
      this.last = onScreen;
      this.movedAt = performance.now();
      clearTimeout(this.stillTimer);
      this.stillTimer = setTimeout(this.parts.onStill, STILL_MS);
    }
    if (this.isDue) this.throttle.call();
  }

  /** Calls `make` with the pose of an image, once the surfaces are those for it, or after a while. One image after the other. */
  image<T>(scale: number, make: (pose: CameraPose) => Promise<T>): Promise<T> {
    const image = this.images.then(() => this.makeImage(scale, make));
    this.images = image.catch(() => undefined);
    return image;
  }

  private async makeImage<T>(scale: number, make: (pose: CameraPose) => Promise<T>): Promise<T> {
    const { pose } = this.parts.scene.camera;
    if (this.followers.length === 0) return make(pose);
    this.ofImage = pictureCamera(this.parts.scene, pose, scale);
    try {
      await this.settled();
      return await make(pose);
    } finally {
      this.ofImage = undefined;
      this.changed();
    }
  }

  private async settled(): Promise<void> {
    const { isSettled, store } = this.parts;
    this.changed();
    for (const began = performance.now(); !isSettled() && performance.now() - began < WAIT_MS; ) {
      if (store.viewer.connection !== "connected") return;
      await new Promise((done) => setTimeout(done, POLL_MS));
    }
  }

  private get wanted(): ViewCamera | null | undefined {
    if (this.ofImage !== undefined) return this.ofImage;
    return this.parts.isLed() ? null : this.onScreen;
  }

  /** Numbers of the surfaces that follow the camera. */
  private get followers(): readonly number[] {
    return wantedOf(this.parts.store.state).surfaces.flatMap(({ number, view }) => (followsCamera(view) ? [number] : []));
  }

  /** One camera is on its way at a time, so that each surface is known to be for the last one. */
  private send(): void {
    const { client, store } = this.parts;
    const { wanted, followers } = this;
    if (wanted === undefined || followers.length === 0 || isWorking(store.viewer) || isCameraAwaited(store.viewer)) return;
    // Whether the member in control has another camera is not known.
    if (client.sendCamera(wanted)) this.await(wanted === null ? [] : followers);
  }

  private await(surfaces: readonly number[]): void {
    const { store } = this.parts;
    store.dispatch({ type: "camera", surfaces });
    clearTimeout(this.waitTimer);
    this.waitTimer = setTimeout(() => {
      if (!isCameraAwaited(store.viewer)) return;
      store.dispatch({ type: "camera", surfaces: [] });
      this.changed();
    }, WAIT_MS);
  }
}
