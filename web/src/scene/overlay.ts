/** Elements that lie over the picture: labels at places in the world, the scale bar, the axes cube, handles. */

import { Vector3, type Camera } from "three";
import "./overlay.css";

/** A text at a place in the world. */
export interface Label {
  readonly text: string;
  readonly at: Vector3;
  /** Pixels of the page by which it stands above. */
  readonly raised?: number;
  /** Whether it is on the surface. Then it is fainter while something is in front of it. */
  readonly isOnSurface?: boolean;
}

/** Pixels from the upper left corner; `undefined` behind the camera. */
export function onScreen(at: Vector3, camera: Camera, width: number, height: number): { readonly x: number; readonly y: number } | undefined {
  const p = at.clone().project(camera);
  if (p.z < -1 || p.z > 1 || !Number.isFinite(p.x)) return undefined;
  return { x: (0.5 + 0.5 * p.x) * width, y: (0.5 - 0.5 * p.y) * height };
}

/** Moves an element to a place in the world, and hides it if that is behind the camera. */
export function placeAt(element: HTMLElement, at: Vector3, camera: Camera, width: number, height: number, raised = 0): void {
  const place = onScreen(at, camera, width, height);
  element.hidden = place === undefined;
  if (place !== undefined) element.style.transform = `translate(${place.x.toFixed(1)}px, ${(place.y - raised).toFixed(1)}px) translate(-50%, -50%)`;
}

export class Overlay {
  readonly element = document.createElement("div");
  private readonly texts = document.createElement("div");
  private width = 1;
  private height = 1;
  private shown: readonly Label[] = [];

  constructor(container: HTMLElement) {
    this.element.className = "scene-overlay";
    this.texts.className = "scene-labels";
    this.texts.setAttribute("aria-hidden", "true");
    this.element.append(this.texts);
    container.append(this.element);
  }

  get size(): { readonly width: number; readonly height: number } {
    return { width: this.width, height: this.height };
  }

  resize(width: number, height: number): void {
    this.width = width;
    this.height = height;
  }

  /** Whether some of the labels may be behind the surface. */
  get hasPlaces(): boolean {
    return this.shown.some(({ isOnSurface }) => isOnSurface);
  }

  /** Makes labels behind the surface fainter. */
  fade(isHidden: (label: Label) => boolean): void {
    this.shown.forEach((label, i) => this.texts.children[i]?.classList.toggle("behind", label.isOnSurface === true && isHidden(label)));
  }

  /** Shows exactly these labels. */
  label(labels: readonly Label[], camera: Camera): void {
    this.shown = labels;
    while (this.texts.childElementCount > labels.length) this.texts.lastElementChild?.remove();
    while (this.texts.childElementCount < labels.length) this.texts.append(document.createElement("span"));
    labels.forEach(({ text, at, raised }, i) => {
      const span = this.texts.children[i] as HTMLElement;
      if (span.textContent !== text) span.textContent = text;
      placeAt(span, at, camera, this.width, this.height, raised);
    });
  }
}
