/** What lies under a pixel: one pixel is rendered with the surface's place instead of its colour. */

import { FloatType, NearestFilter, RGBAFormat, PerspectiveCamera, Vector3, WebGLRenderTarget, type OrthographicCamera, type WebGLRenderer } from "three";
import type { Vec3 } from "./world";

export interface Picked {
  /** World units. */
  readonly position: Vec3;
  /** Number of the surface. */
  readonly surface: number;
}

/** Rows of a picture so large that one of its pixels is a point. */
const ACROSS = 8192;

export class Picking {
  private readonly target = new WebGLRenderTarget(1, 1, { type: FloatType, format: RGBAFormat, minFilter: NearestFilter, magFilter: NearestFilter });

  /**
   * @param x share of the width from the left
   * @param y share of the height from the top
   * @param draw renders the surfaces in the materials of pass `pick` as this camera sees them
   * @returns the nearest point of a surface; `undefined` where there is none
   */
  async pick(
    webgl: WebGLRenderer,
    camera: PerspectiveCamera | OrthographicCamera,
    x: number,
    y: number,
    draw: (camera: PerspectiveCamera | OrthographicCamera) => void,
  ): Promise<Picked | undefined> {
    const eye = camera.clone();
    const aspect = eye instanceof PerspectiveCamera ? eye.aspect : eye.right / eye.top;
    eye.setViewOffset(ACROSS * aspect, ACROSS, Math.floor(x * ACROSS * aspect), Math.floor(y * ACROSS), 1, 1);
    webgl.setRenderTarget(this.target);
    webgl.setClearColor(0x000000, 0);
    webgl.clear();
    draw(eye);
    webgl.setRenderTarget(null);
    const found = new Float32Array(4);
    await webgl.readRenderTargetPixelsAsync(this.target, 0, 0, 1, 1, found);
    const [vx = 0, vy = 0, vz = 0, number = 0] = found;
    if (number === 0) return undefined;
    return { position: new Vector3(vx, vy, vz).applyMatrix4(eye.matrixWorld).toArray(), surface: number - 1 };
  }
}
