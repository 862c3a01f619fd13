/** A picture of the scene as pixels, at any size: for images, not for the screen. */

import { WebGLRenderTarget, type WebGLRenderer } from "three";
import { isBehind } from "./hiddenPlaces";
import { onScreen } from "./overlay";
import type { Annotations } from "./annotations";
import type { SceneCamera } from "./camera";
import type { Look } from "./look";
import type { Painter } from "./painter";
import { LAYERS_IN_IMAGES } from "./peeling";
import type { CameraPose } from "./pose";
import { commonDepth, heightAt } from "./scale";
import type { Surfaces } from "./surfaces";

export interface SnapshotRequest {
  /** Pixels of the image for one on the page, 1 to 4. */
  readonly scale: number;
  /** Without surroundings: what is no surface is transparent. Else as on screen. */
  readonly transparent: boolean;
  /** The camera's pose; without it the current one is used. */
  readonly pose?: CameraPose;
}

export interface Snapshot {
  readonly width: number;
  readonly height: number;
  /** RGBA, not premultiplied, rows from the top. */
  readonly pixels: Uint8ClampedArray<ArrayBuffer>;
  /** Texts that belong to the picture, in its pixels. */
  readonly labels: readonly { readonly text: string; readonly x: number; readonly y: number; readonly isBehind: boolean }[];
  /** World units of one of its pixels, right to within a twentieth over its middle third; `undefined` if that has surfaces at too different depths. */
  readonly unitsPerPixel: number | undefined;
}

export interface SnapshotScene {
  readonly webgl: WebGLRenderer;
  readonly painter: Painter;
  readonly camera: SceneCamera;
  readonly annotations: Annotations;
  readonly surfaces: Surfaces;
  readonly look: Look;
  /** CSS pixels. */
  readonly size: { readonly width: number; readonly height: number };
  readonly swipe: number | undefined;
}

/**
 * Renders it now, with all effects.
 * @throws if the graphics device cannot render the requested number of pixels
 */
export function takeSnapshot(scene: SnapshotScene, { scale, transparent, pose }: SnapshotRequest): Snapshot {
  const { webgl, painter, annotations, surfaces, look, swipe } = scene;
  const [width, height] = [Math.round(scene.size.width * scale), Math.round(scene.size.height * scale)];
  const max = webgl.capabilities.maxTextureSize;
  if (width > max || height > max) throw new Error(`an image of ${width} × ${height} pixels, this graphics device allows ${max} on a side`);
  const camera = scene.camera.at(pose ?? scene.camera.pose);
  const labels = annotations.place(camera, surfaces.volumeBox, scale);
  const target = new WebGLRenderTarget(width, height, { samples: 4 });
  try {
    painter.paint({
      target,
      width,
      height,
      camera,
      look: transparent ? { ...look, background: "transparent" } : look,
      effects: true,
      layers: LAYERS_IN_IMAGES,
      scale,
      swipe,
      radius: scene.camera.radius,
      fineness: 1,
    });
    const depth = commonDepth(camera, painter.depthsNow(camera));
    const unitsPerPixel = depth === undefined ? undefined : heightAt(camera, depth) / height;
    const raw = new Uint8Array(4 * width * height);
    webgl.readRenderTargetPixels(target, 0, 0, width, height, raw);
    const depths = labels.some(({ isOnSurface }) => isOnSurface) ? painter.depthMapNow(camera) : [];
    const places = labels.flatMap(({ text, at, raised = 0, isOnSurface }) => {
      const place = onScreen(at, camera, width, height);
      return place === undefined ? [] : [{ text, x: place.x, y: place.y - raised * scale, isBehind: isOnSurface === true && isBehind(at, camera, depths) }];
    });
    return { width, height, pixels: upright(raw, width, height), labels: places, unitsPerPixel };
  } finally {
    target.dispose();
    painter.releaseTargets();
    webgl.setRenderTarget(null);
  }
}

/** Rows from the top, colours not premultiplied. */
function upright(raw: Uint8Array, width: number, height: number): Uint8ClampedArray<ArrayBuffer> {
  const pixels = new Uint8ClampedArray(raw.length);
  for (let y = 0; y < height; y += 1) pixels.set(raw.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
  for (let i = 0; i < pixels.length; i += 4) {
    const alpha = pixels[i + 3] ?? 0;
    if (alpha === 0 || alpha === 255) continue;
    for (let c = i; c < i + 3; c += 1) pixels[c] = ((pixels[c] ?? 0) * 255) / alpha;
  }
  return pixels;
}
