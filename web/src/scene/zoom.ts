/** Zoom towards the place of a surface under the pointer: it keeps its place in the picture, and the camera stops in front of it. */

import { Vector3 } from "three";
import type { Projection } from "./pose";
import type { Vec3 } from "./world";

/** Position of a camera, and the point that it turns around. */
export interface Viewpoint {
  readonly position: Vector3;
  readonly target: Vector3;
}

/** Brings the target to the depth of a point; the picture stays as it is. A point behind the camera changes nothing. */
export function focused({ position, target }: Viewpoint, point: Vector3, projection: Projection): Viewpoint {
  const forward = target.clone().sub(position);
  const distance = forward.length();
  forward.divideScalar(distance);
  const depth = point.clone().sub(position).dot(forward);
  // An orthographic camera's distance is its zoom: it moves with its target.
  if (projection === "orthographic") return { position: position.clone().addScaledVector(forward, depth - distance), target: target.clone().addScaledVector(forward, depth - distance) };
  return depth > 1e-6 * distance ? { position, target: position.clone().addScaledVector(forward, depth) } : { position, target };
}

/** Multiplies the distance by `factor`, within bounds if it is within them now; `point` keeps its place in the picture. */
export function zoomed({ position, target }: Viewpoint, point: Vector3, factor: number, [nearest, farthest]: readonly [number, number]): Viewpoint {
  const distance = position.distanceTo(target);
  const bounded = factor < 1 ? Math.min(1, Math.max(factor, nearest / distance)) : Math.max(1, Math.min(factor, farthest / distance));
  const move = (v: Vector3) => point.clone().lerp(v, bounded);
  return { position: move(position), target: move(target) };
}

/** A place in the picture: shares of half its width and height from the middle, to the right and up. */
export type PlaceInPicture = readonly [x: number, y: number];

export interface Zooming {
  /** Zooms towards a point, or, without one, towards a place in the picture at the depth of the target. */
  zoomTowards(point: Vec3 | undefined, place: PlaceInPicture, factor: number): void;
  /** Brings the target to the depth of a point. */
  focus(point: Vec3): void;
}

/** The point of a surface at a place of the page; `undefined` if there is none. */
export type PickPoint = (clientX: number, clientY: number) => Promise<Vec3 | undefined>;

/** Turns of the wheel that follow each other within this time, at about one place, zoom towards one point. */
const GESTURE_MS = 400;
const SAME_PLACE = 12;
/** The distance after one step of a wheel's 100 pixels is 0.84 of that before. */
const PER_STEP = 0.95;
const PIXELS = /Mac/.test(navigator.userAgent) ? 10 : 30;

/**
 * Listens to wheel, fingers and middle button. Drags are left to the camera's own controls; the gestures here place the target that those
 * controls turn around.
 */
export class ZoomGestures {
  private at: readonly [number, number] = [0, 0];
  private lastAt = -Infinity;
  private point: Vec3 | undefined;
  /** Of turns of the wheel before the point is known. */
  private pending: number | undefined;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Zooming,
    private readonly pick: PickPoint,
  ) {
    canvas.addEventListener("wheel", (event) => this.turn(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button === 1) void this.focusOn(event.clientX, event.clientY);
    });
    canvas.addEventListener("touchstart", ({ touches: [a, b] }) => {
      if (a !== undefined && b !== undefined) void this.focusOn((a.clientX + b.clientX) / 2, (a.clientY + b.clientY) / 2);
    }, { passive: true });
  }

  /** Zooms towards what is in the middle of the picture. */
  async zoomAtCentre(factor: number): Promise<void> {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    this.camera.zoomTowards(await this.pick(left + width / 2, top + height / 2), [0, 0], factor);
  }

  private async focusOn(x: number, y: number): Promise<void> {
    const point = await this.pick(x, y);
    if (point !== undefined) this.camera.focus(point);
  }

  private turn(event: WheelEvent): void {
    event.preventDefault();
    // Two fingers on a touchpad come as a wheel with Control.
    const steps = event.deltaMode === WheelEvent.DOM_DELTA_LINE || event.ctrlKey ? (event.deltaY * 10) / PIXELS : event.deltaY / PIXELS;
    const factor = PER_STEP ** -steps;
    const apart = Math.hypot(event.clientX - this.at[0], event.clientY - this.at[1]);
    const goesOn = event.timeStamp - this.lastAt < GESTURE_MS && apart < SAME_PLACE;
    this.lastAt = event.timeStamp;
    if (this.pending !== undefined) this.pending *= factor;
    else if (goesOn) this.zoom(factor);
    else void this.begin(event.clientX, event.clientY, factor);
  }

  private async begin(x: number, y: number, factor: number): Promise<void> {
    this.at = [x, y];
    this.pending = factor;
    this.point = await this.pick(x, y).catch(() => undefined);
    const all = this.pending;
    this.pending = undefined;
    this.zoom(all);
  }

  private zoom(factor: number): void {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const [x, y] = this.at;
    this.camera.zoomTowards(this.point, [(2 * (x - left)) / width - 1, 1 - (2 * (y - top)) / height], factor);
  }
}
