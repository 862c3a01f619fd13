/** A crosshair in the volume: a line along each of its axes through one place. Fainter behind the surface. */

import { AlwaysDepth, BufferAttribute, BufferGeometry, Group, LineSegments, Points } from "three";
import { PlainMaterial } from "./plain";
import type { Vec3 } from "./world";

/** World positions: the point at which the lines cross, and the two ends of each. */
export interface CrosshairPlace {
  readonly at: Vec3;
  readonly ends: readonly (readonly [Vec3, Vec3])[];
}

/** As in `ui/style/slices.css`. */
const COLOR = "#2fd4cf";
const [SEEN, HIDDEN] = [0.9, 0.28];
const DOT = 7;

export class Crosshair {
  readonly object = new Group();
  /** Ends of three lines, and a point. */
  private readonly ends = new BufferAttribute(new Float32Array(18), 3);
  private readonly at = new BufferAttribute(new Float32Array(3), 3);
  private readonly dots: readonly PlainMaterial[];

  constructor() {
    const [lines, dot] = [new BufferGeometry().setAttribute("position", this.ends), new BufferGeometry().setAttribute("position", this.at)];
    const materials = [HIDDEN, SEEN].map((opacity) => new PlainMaterial(COLOR, opacity));
    this.dots = [HIDDEN, SEEN].map((opacity) => new PlainMaterial(COLOR, opacity, DOT));
    [...materials, ...this.dots].forEach((material, i) => {
      material.depthWrite = false;
      if (i % 2 === 0) material.depthFunc = AlwaysDepth;
      else if (i === 3) material.bringForward();
      const drawn = i < 2 ? new LineSegments(lines, material) : new Points(dot, material);
      drawn.frustumCulled = false;
      drawn.renderOrder = i;
      this.object.add(drawn);
    });
  }

  /** Pixels of the target for one on the page. */
  set scale(scale: number) {
    for (const dot of this.dots) dot.pointScale = scale;
  }

  place({ at, ends }: CrosshairPlace): void {
    this.ends.copyArray(ends.flat(2)).needsUpdate = true;
    this.at.copyArray(at).needsUpdate = true;
  }
}
