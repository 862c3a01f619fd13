/** Dots at places in the world, with an outline so that they are seen on any colour. */

import { BufferAttribute, BufferGeometry, Group, Points, Vector3 } from "three";
import type { Label } from "./overlay";
import { PlainMaterial } from "./plain";
import type { Vec3 } from "./world";

export interface Marker {
  /** World units. */
  readonly position: Vec3;
  /** `#rrggbb` */
  readonly color: string;
  /** Text beside it. */
  readonly text?: string;
}

/** Diameters in pixels of the page. */
const DOT = 9;
const OUTLINE = 13;

export class Markers {
  readonly object = new Group();
  private shown: readonly Marker[] = [];
  private dots: Points<BufferGeometry, PlainMaterial>[] = [];

  set(markers: readonly Marker[]): void {
    for (const { geometry, material } of this.dots) {
      geometry.dispose();
      material.dispose();
    }
    this.dots = [];
    this.object.clear();
    this.shown = markers;
    markers.forEach(({ position, color }, i) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(position), 3));
      [["#ffffff", OUTLINE], [color, DOT]].forEach(([style, size], layer) => {
        const points = new Points(geometry, new PlainMaterial(String(style), 1, Number(size)));
        // A dot on the surface lies half behind it: it must be hidden only by things clearly in front of it.
        points.material.bringForward();
        points.frustumCulled = false;
        points.renderOrder = 20 + 2 * i + layer;
        this.dots.push(points);
        this.object.add(points);
      });
    });
  }

  /** Pixels of the target for one on the page. */
  set scale(scale: number) {
    for (const { material } of this.dots) material.pointScale = scale;
  }

  get labels(): Label[] {
    return this.shown.flatMap(({ text, position }) => (text === undefined ? [] : [{ text, at: new Vector3(...position), raised: 16 }]));
  }
}
