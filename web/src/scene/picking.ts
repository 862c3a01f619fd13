/** Picking of the surface under a pixel, and depths of the picture: pixels are rendered with the surface's position instead of its colour. */

import { FloatType, NearestFilter, RGBAFormat, PerspectiveCamera, Vector3, WebGLRenderTarget, type OrthographicCamera, type WebGLRenderer } from "three";
import { ACROSS } from "./hiddenPlaces";
import { middleDepths, type MiddleDepths } from "./scale";
import type { Vec3 } from "./world";

export interface Picked {
  /** World units. */
  readonly position: Vec3;
  /** Number of the surface. */
  readonly surface: number;
}

/** Rows of a picture so large that one of its pixels is a point. */
const POINTS = 8192;
/** Points along each side of the middle third. */
const MIDDLE = 25;

type Camera = PerspectiveCamera | OrthographicCamera;
/** Renders the surfaces in the materials of pass `pick` as this camera sees them. */
type Draw = (camera: Camera) => void;

function pixels(size: number): WebGLRenderTarget {
  return new WebGLRenderTarget(size, size, { type: FloatType, format: RGBAFormat, minFilter: NearestFilter, magFilter: NearestFilter });
}

export class Picking {
  private readonly target = pixels(1);
  private readonly middle = pixels(MIDDLE);
  private readonly whole = pixels(ACROSS);

  /**
   * @param x share of the width from the left
   * @param y share of the height from the top
   * @returns the nearest point of a surface; `undefined` if there is none
   */
  async pick(
    webgl: WebGLRenderer,
    camera: Camera,
    x: number,
    y: number,
    draw: Draw,
  ): Promise<Picked | undefined> {
    const eye = camera.clone();
    const aspect = eye instanceof PerspectiveCamera ? eye.aspect : eye.right / eye.top;
    eye.setViewOffset(POINTS * aspect, POINTS, Math.floor(x * POINTS * aspect), Math.floor(y * POINTS), 1, 1);
    render(webgl, this.target, eye, draw);
    const found = new Float32Array(4);
    await webgl.readRenderTargetPixelsAsync(this.target, 0, 0, 1, 1, found);
    const [vx = 0, vy = 0, vz = 0, number = 0] = found;
    if (number === 0) return undefined;
    return { position: new Vector3(vx, vy, vz).applyMatrix4(eye.matrixWorld).toArray(), surface: number - 1 };
  }

  /** Depths of surfaces in the middle third of the picture. */
  async depths(webgl: WebGLRenderer, camera: Camera, draw: Draw): Promise<MiddleDepths> {
    render(webgl, this.middle, middleThird(camera), draw);
    const found = new Float32Array(4 * MIDDLE * MIDDLE);
    await webgl.readRenderTargetPixelsAsync(this.middle, 0, 0, MIDDLE, MIDDLE, found);
    return middleDepths(depthsOf(found));
  }

  /** Depths of the nearest surface at points over the whole picture, rows from below; 0 if there is none. */
  async map(webgl: WebGLRenderer, camera: Camera, draw: Draw): Promise<number[]> {
    render(webgl, this.whole, camera.clone(), draw);
    const found = new Float32Array(4 * ACROSS * ACROSS);
    await webgl.readRenderTargetPixelsAsync(this.whole, 0, 0, ACROSS, ACROSS, found);
    return depthsOf(found);
  }

  /** As `map`, at once: for images. */
  mapNow(webgl: WebGLRenderer, camera: Camera, draw: Draw): number[] {
    render(webgl, this.whole, camera.clone(), draw);
    const found = new Float32Array(4 * ACROSS * ACROSS);
    webgl.readRenderTargetPixels(this.whole, 0, 0, ACROSS, ACROSS, found);
    return depthsOf(found);
  }

  /** As `depths`, at once: for images. */
  depthsNow(webgl: WebGLRenderer, camera: Camera, draw: Draw): MiddleDepths {
    render(webgl, this.middle, middleThird(camera), draw);
    const found = new Float32Array(4 * MIDDLE * MIDDLE);
    webgl.readRenderTargetPixels(this.middle, 0, 0, MIDDLE, MIDDLE, found);
    return middleDepths(depthsOf(found));
  }
}

function render(webgl: WebGLRenderer, target: WebGLRenderTarget, camera: Camera, draw: Draw): void {
  webgl.setRenderTarget(target);
  webgl.setClearColor(0x000000, 0);
  webgl.clear();
  draw(camera);
  webgl.setRenderTarget(null);
}

function middleThird(camera: Camera): Camera {
  const eye = camera.clone();
  eye.setViewOffset(3 * MIDDLE, 3 * MIDDLE, MIDDLE, MIDDLE, MIDDLE, MIDDLE);
  return eye;
}

/** View position and surface number of each pixel; 0: no surface. */
function depthsOf(found: Float32Array): number[] {
  return Array.from({ length: found.length / 4 }, (_, i) => (found[4 * i + 3] === 0 ? 0 : -(found[4 * i + 2] ?? 0)));
}
