/** What a volume that is drawn along the rays of the picture has to offer to the painter. Its code is loaded when one is first shown. */

import type { Matrix4, OrthographicCamera, PerspectiveCamera, Texture, Vector4, WebGLRenderer } from "three";

export interface Rays {
  readonly camera: PerspectiveCamera | OrthographicCamera;
  /** In view space. Points on the negative side of any plane are clipped. */
  readonly clipPlanes: readonly Vector4[];
  /** Depth of what is opaque. */
  readonly opaque: Texture;
  /** Depths between which the rays are followed: those of two translucent layers. */
  readonly from?: Texture | undefined;
  readonly to?: Texture | undefined;
  /** Pixels. */
  readonly width: number;
  readonly height: number;
  /** Pixels for one of the picture, along each side. */
  readonly fineness: number;
}

export interface RayVolume {
  /** It is drawn between translucent layers, not behind all of them. */
  readonly isBetweenLayers: boolean;
  /** Its colours, premultiplied; maybe of fewer pixels than the picture. */
  render(webgl: WebGLRenderer, rays: Rays): Texture;
  /** Frees what is made again when needed. */
  releaseTargets(): void;
}

/** Planes of view space in another space. @param viewFrom from that space to view space */
export function planesIn(viewFrom: Matrix4, planes: readonly Vector4[]): Vector4[] {
  const transposed = viewFrom.clone().transpose();
  return planes.map((plane) => plane.clone().applyMatrix4(transposed));
}
