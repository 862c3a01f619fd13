/** Handles on the faces of the clip: dragged along their normal, or moved by arrow keys. */

import { Vector3, type Box3, type Camera } from "three";
import type { Clip } from "./clipping";
import { onScreen, placeAt } from "./overlay";
import { tickText } from "../world/ticks";

/** Step of a key, in diagonals of the volume; ten times as long with shift. */
const KEY_STEP = 0.005;

interface Handle {
  readonly name: string;
  /** Its position, and the unit vector along which it moves. */
  readonly at: Vector3;
  readonly along: Vector3;
  /** Its coordinate along that vector. */
  readonly value: number;
  /** The clip with another coordinate. */
  readonly moved: (value: number) => Clip;
}

/** Handles of a clip. `bounds`: box of the part that the clip keeps. */
export function handlesOf(clip: Clip, bounds: Box3): Handle[] {
  const handles: Handle[] = [];
  const { plane, box } = clip;
  if (plane !== undefined) {
    const along = new Vector3(...plane.normal);
    const center = bounds.getCenter(new Vector3());
    const at = center.addScaledVector(along, plane.offset - along.dot(center));
    handles.push({ name: "Clip plane", at, along, value: plane.offset, moved: (offset) => ({ ...clip, plane: { ...plane, offset } }) });
  }
  if (box === undefined) return handles;
  for (const axis of [0, 1, 2] as const) {
    for (const side of ["min", "max"] as const) {
      const at = new Vector3(...box.min).add(new Vector3(...box.max)).divideScalar(2).setComponent(axis, box[side][axis]);
      const moved = (value: number): Clip => {
        // Not past the face on the other side.
        const inside = side === "min" ? Math.min(value, box.max[axis]) : Math.max(value, box.min[axis]);
        return { ...clip, box: { ...box, [side]: box[side].map((v, i) => (i === axis ? inside : v)) } };
      };
      const name = `Clip box, ${side === "min" ? "low" : "high"} ${"xyz"[axis] ?? ""}`;
      handles.push({ name, at, along: new Vector3().setComponent(axis, 1), value: box[side][axis], moved });
    }
  }
  return handles;
}

export class ClipHandles {
  readonly element = document.createElement("div");
  private handles: Handle[] = [];
  private camera: Camera | undefined;
  private size = { width: 1, height: 1 };
  private step = 1;

  /** @param onMove the user moves a face: the clip to set */
  constructor(private readonly onMove: (clip: Clip) => void) {}

  update(clip: Clip, bounds: Box3, camera: Camera, size: { readonly width: number; readonly height: number }): void {
    this.handles = handlesOf(clip, bounds);
    this.camera = camera;
    this.size = size;
    this.step = KEY_STEP * bounds.getSize(new Vector3()).length();
    while (this.element.childElementCount > this.handles.length) this.element.lastElementChild?.remove();
    while (this.element.childElementCount < this.handles.length) this.element.append(this.makeButton(this.element.childElementCount));
    this.handles.forEach(({ name, at, value }, i) => {
      const button = this.element.children[i] as HTMLElement;
      button.setAttribute("aria-label", name);
      button.setAttribute("aria-valuenow", String(value));
      button.setAttribute("aria-valuetext", tickText(value, this.step));
      placeAt(button, at, camera, size.width, size.height);
    });
  }

  private makeButton(index: number): HTMLElement {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "scene-handle";
    button.setAttribute("role", "slider");
    let grabbed: { readonly x: number; readonly y: number; readonly handle: Handle; readonly right: number; readonly down: number } | undefined;
    button.addEventListener("pointerdown", (event) => {
      const handle = this.handles[index];
      const direction = handle === undefined ? undefined : this.screenDirection(handle);
      if (handle === undefined || direction === undefined) return;
      button.setPointerCapture(event.pointerId);
      grabbed = { x: event.clientX, y: event.clientY, handle, ...direction };
    });
    button.addEventListener("pointermove", (event) => {
      if (grabbed === undefined) return;
      const { x, y, handle, right, down } = grabbed;
      // Pixels along the axis, in world units.
      const moved = ((event.clientX - x) * right + (event.clientY - y) * down) / (right * right + down * down);
      this.onMove(handle.moved(handle.value + moved));
    });
    for (const type of ["pointerup", "pointercancel"] as const) button.addEventListener(type, () => (grabbed = undefined));
    button.addEventListener("keydown", (event) => {
      const sign = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1 }[event.key];
      const handle = this.handles[index];
      if (sign === undefined || handle === undefined) return;
      event.preventDefault();
      this.onMove(handle.moved(handle.value + sign * this.step * (event.shiftKey ? 10 : 1)));
    });
    return button;
  }

  /** Pixels that a world unit along the handle's axis takes, to the right and down; `undefined` if the axis is seen end on. */
  private screenDirection({ at, along }: Handle): { readonly right: number; readonly down: number } | undefined {
    const { camera, size, step } = this;
    if (camera === undefined) return undefined;
    const from = onScreen(at, camera, size.width, size.height);
    const to = onScreen(at.clone().addScaledVector(along, step), camera, size.width, size.height);
    if (from === undefined || to === undefined) return undefined;
    const [right, down] = [(to.x - from.x) / step, (to.y - from.y) / step];
    return Math.hypot(right, down) * step > 0.2 ? { right, down } : undefined;
  }
}
