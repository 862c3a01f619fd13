/** The box around the volume, with ticks at round world coordinates along three of its edges. */

import { BufferAttribute, BufferGeometry, LineSegments, Vector3, type Box3, type Camera } from "three";
import type { Label } from "./overlay";
import { PlainMaterial } from "./plain";
import type { PhysicalAxis, PlacedTick } from "../world/physicalAxes";
import { ticks, tickText } from "../world/ticks";

const MAX_TICKS = 6;
/** Length of a tick and distance of its number, in diagonals of the box. */
const TICK = 0.012;
const NUMBER = 0.035;
/** Numbers stand this far apart, in halves of the picture. */
const NEAREST_NUMBERS = 0.045;
const AXES = ["x", "y", "z"] as const;

export class BoundingBox {
  readonly object: LineSegments<BufferGeometry, PlainMaterial>;
  /** The world's unit. */
  unit = "";
  /** Positions along the world's axes that the file describes: longitudes, depths. */
  axes: readonly (PhysicalAxis | undefined)[] = [];
  private labels: Label[] = [];

  constructor() {
    this.object = new LineSegments(new BufferGeometry(), new PlainMaterial("#7d8997"));
    this.object.frustumCulled = false;
  }

  set style(color: string) {
    this.object.material.style = color;
  }

  /** Updates edges and ticks for the camera, and returns the numbers of the ticks. */
  update(box: Box3, camera: Camera): readonly Label[] {
    this.labels = [];
    const lines: Vector3[] = [];
    const corner = (i: number) => new Vector3(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z);
    for (let axis = 0; axis < 3; axis += 1) {
      for (let i = 0; i < 8; i += 1) if ((i & (1 << axis)) === 0) lines.push(corner(i), corner(i | (1 << axis)));
      this.addTicks(axis as 0 | 1 | 2, box, camera, lines);
    }
    this.object.geometry.dispose();
    this.object.geometry = new BufferGeometry();
    this.object.geometry.setAttribute("position", new BufferAttribute(new Float32Array(lines.flatMap((p) => p.toArray())), 3));
    return this.labels;
  }

  private addTicks(axis: 0 | 1 | 2, box: Box3, camera: Camera, lines: Vector3[]): void {
    const edge = tickedEdge(axis, box, camera);
    if (edge === undefined) return;
    const size = box.getSize(new Vector3()).length();
    let last: Vector3 | undefined;
    for (const { at: coordinate, text } of this.ticksOf(axis, box.min.getComponent(axis), box.max.getComponent(axis))) {
      const at = edge.at.clone().setComponent(axis, coordinate);
      lines.push(at, at.clone().addScaledVector(edge.outward, TICK * size));
      const seen = at.clone().project(camera);
      // Positions may be uneven: a number over another one is left out.
      if (last !== undefined && Math.abs(seen.x - last.x) < NEAREST_NUMBERS && Math.abs(seen.y - last.y) < NEAREST_NUMBERS) continue;
      last = seen;
      this.labels.push({ text, at: at.clone().addScaledVector(edge.outward, NUMBER * size) });
    }
    const middle = edge.at.clone().setComponent(axis, (box.min.getComponent(axis) + box.max.getComponent(axis)) / 2);
    const name = this.axes[axis]?.title ?? (this.unit === "" ? AXES[axis] : `${AXES[axis]} (${this.unit})`);
    this.labels.push({ text: name, at: middle.addScaledVector(edge.outward, 2.4 * NUMBER * size) });
  }

  private ticksOf(axis: 0 | 1 | 2, low: number, high: number): readonly PlacedTick[] {
    const known = this.axes[axis];
    if (known !== undefined) return known.ticks(low, high, MAX_TICKS);
    const values = ticks(low, high, MAX_TICKS);
    const step = values.length > 1 ? (values[1] ?? 0) - (values[0] ?? 0) : high - low;
    return values.map((value) => ({ at: value, text: tickText(value, step) }));
  }
}

/**
 * Chooses one of the four edges along an axis, at the outline of the box as seen, so that its numbers lie beside the picture: the lowest, and
 * among upright ones the leftmost. None if the axis is seen end on.
 */
function tickedEdge(axis: 0 | 1 | 2, box: Box3, camera: Camera): { readonly at: Vector3; readonly outward: Vector3 } | undefined {
  const center = box.getCenter(new Vector3());
  const seen = (p: Vector3) => p.clone().project(camera);
  const [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
  let best: { at: Vector3; outward: Vector3; rank: number } | undefined;
  for (let i = 0; i < 4; i += 1) {
    const at = center.clone();
    at.setComponent(b, (i & 1 ? box.max : box.min).getComponent(b)).setComponent(c, (i & 2 ? box.max : box.min).getComponent(c));
    const ends = [box.min, box.max].map((end) => seen(at.clone().setComponent(axis, end.getComponent(axis))));
    const [low, high] = ends;
    if (low === undefined || high === undefined || low.distanceTo(high) < 0.05) continue;
    const middle = low.clone().add(high).divideScalar(2);
    const upright = Math.abs(high.y - low.y) > 2 * Math.abs(high.x - low.x);
    const rank = upright ? -middle.x : -middle.y;
    const outward = at.clone().sub(center).normalize();
    if (best === undefined || rank > best.rank) best = { at, outward, rank };
  }
  return best;
}
