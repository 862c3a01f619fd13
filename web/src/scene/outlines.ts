/** Outlines of regions of the world: three circles a sphere, twelve edges a box. Fainter behind the surface. */

import { AlwaysDepth, BufferAttribute, BufferGeometry, Group, LineSegments } from "three";
import { PlainMaterial } from "./plain";
import type { Vec3 } from "./world";

/** World units. */
export type Outlined = { readonly center: Vec3; readonly radius: number } | { readonly min: Vec3; readonly max: Vec3 };

const COLOR = "#13a8a4";
/** Opacities of visible and of hidden parts, for all outlines and for the one under the pointer. */
const FAINT = [0.7, 0.2] as const;
const STRONG = [1, 0.6] as const;
const SEGMENTS = 64;

export class Outlines {
  readonly object = new Group();
  private lines: LineSegments<BufferGeometry, PlainMaterial>[] = [];

  /** @param strong number of the one under the pointer */
  set(regions: readonly Outlined[], strong: number | undefined): void {
    for (const { geometry, material } of this.lines) {
      geometry.dispose();
      material.dispose();
    }
    this.lines = [];
    this.object.clear();
    this.add(regions.filter((_, i) => i !== strong), FAINT);
    this.add(regions.filter((_, i) => i === strong), STRONG);
  }

  private add(regions: readonly Outlined[], [seen, hidden]: readonly [number, number]): void {
    if (regions.length === 0) return;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(regions.flatMap(linesOf)), 3));
    const behind = new PlainMaterial(COLOR, hidden);
    behind.depthFunc = AlwaysDepth;
    [behind, new PlainMaterial(COLOR, seen)].forEach((material, layer) => {
      material.depthWrite = false;
      const lines = new LineSegments(geometry, material);
      lines.frustumCulled = false;
      lines.renderOrder = layer;
      this.lines.push(lines);
      this.object.add(lines);
    });
  }
}

/** Coordinates of the ends of line segments. */
export function linesOf(region: Outlined): number[] {
  return "radius" in region ? circles(region.center, region.radius) : edges(region.min, region.max);
}

/** Around each axis. */
function circles(center: Vec3, radius: number): number[] {
  return [0, 1, 2].flatMap((axis) =>
    Array.from({ length: 2 * SEGMENTS }, (_, end) => {
      const angle = (2 * Math.PI * ((end + 1) >> 1)) / SEGMENTS;
      const point = [...center];
      point[(axis + 1) % 3] = (center[(axis + 1) % 3] ?? 0) + radius * Math.cos(angle);
      point[(axis + 2) % 3] = (center[(axis + 2) % 3] ?? 0) + radius * Math.sin(angle);
      return point;
    }).flat(),
  );
}

function edges(min: Vec3, max: Vec3): number[] {
  const corner = (i: number) => [(i & 1 ? max : min)[0], (i & 2 ? max : min)[1], (i & 4 ? max : min)[2]];
  return [1, 2, 4].flatMap((bit) => [0, 1, 2, 3, 4, 5, 6, 7].filter((i) => (i & bit) === 0).flatMap((i) => [...corner(i), ...corner(i | bit)]));
}
