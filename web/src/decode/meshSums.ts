/**
 * Area and enclosed volume of a surface, summed up over the meshes of its regions. Pure.
 *
 * The volume is that of the divergence theorem: the sum of the tetrahedra between each triangle and one point, with their signs. It is a
 * volume only if the surface has no border. Positions are multiples of one lattice in all regions, so that a border is found exactly: the
 * edges that triangles pass more often in one direction than in the other.
 */

import { REGION_CELLS } from "../protocol/generated";
import type { Vec3 } from "../protocol/types";
import { evenOf, type Uneven } from "../world/uneven";

export interface MeshSums {
  /** World units squared. */
  readonly area: number;
  /** World units cubed; below 0 if the surface turns its inner side out. It means nothing if there are border edges. */
  readonly volume: number;
  /** Edges that have more triangles on one side than on the other. */
  readonly borderEdges: number;
}

/** The mesh of one region, in the layout of the wire. */
export interface SummedMesh {
  /** Six 16-bit words a vertex, of which the first three are its position. */
  readonly vertices: Int16Array;
  readonly indices: Uint16Array | Uint32Array;
  /** Region coordinates: of its low corner, whatever its size. */
  readonly region: Vec3;
  /** Position units per cell. */
  readonly lattice: number;
}

const STRIDE = 6;
/** Positions that borders have, at most. */
const MAX_POINTS = 2 ** 26;

/** World vectors of one step along each axis of the even grid. */
export type WorldAxes = readonly [Vec3, Vec3, Vec3];

export class MeshSummation {
  private readonly scale: number;
  /** The apex of all tetrahedra: near the surface, for the digits. In the even grid. */
  private origin: Vec3 | undefined;
  private area = 0;
  /** In cells of the even grid, six times. */
  private volume = 0;
  private readonly border = new Border();

  /**
   * @param axes world vectors of a step along each axis of the even grid
   * @param uneven axes whose samples are not those of that grid
   */
  constructor(
    private readonly axes: WorldAxes,
    private readonly uneven?: Uneven,
  ) {
    const [x, y, z] = axes;
    this.scale = Math.abs(dot(x, cross(y, z)));
  }

  add(mesh: SummedMesh): void {
    const points = pointsOf(mesh, this.uneven);
    const origin = (this.origin ??= at(points, 0));
    for (let i = 0; i < mesh.indices.length; i += 3) {
      const a = minus(at(points, mesh.indices[i] ?? 0), origin);
      const b = minus(at(points, mesh.indices[i + 1] ?? 0), origin);
      const c = minus(at(points, mesh.indices[i + 2] ?? 0), origin);
      this.volume += dot(a, cross(b, c));
      this.area += length(cross(this.inWorld(minus(b, a)), this.inWorld(minus(c, a)))) / 2;
    }
    for (const [from, to, times] of openEdges(mesh.indices, points.length / 3)) this.border.add(at(points, from), at(points, to), times);
  }

  get sums(): MeshSums {
    return { area: this.area, volume: (this.scale * this.volume) / 6, borderEdges: this.border.edges };
  }

  private inWorld([i, j, k]: Vec3): Vec3 {
    const [x, y, z] = this.axes;
    return [x[0] * i + y[0] * j + z[0] * k, x[1] * i + y[1] * j + z[1] * k, x[2] * i + y[2] * j + z[2] * k];
  }
}

/** Three coordinates a vertex, of the even grid; exact, because a lattice has a power of two of units to a cell or the same in all regions. */
function pointsOf({ vertices, region, lattice }: SummedMesh, uneven: Uneven | undefined): Float64Array {
  const points = new Float64Array((3 * vertices.length) / STRIDE);
  for (let i = 0; i < points.length; i += 1) {
    const axis = i % 3;
    const word = vertices[STRIDE * ((i - axis) / 3) + axis] ?? 0;
    const index = ((region[axis as 0 | 1 | 2]) * REGION_CELLS * lattice + word) / lattice;
    points[i] = uneven === undefined ? index : evenOf(uneven[axis as 0 | 1 | 2], index);
  }
  return points;
}

/**
 * Edges of one mesh that are passed more often in one direction than in the other: from, to, and how much more often.
 * @param count of vertices
 */
function* openEdges(indices: SummedMesh["indices"], count: number): Generator<readonly [number, number, number]> {
  // Twice the number of the edge, one more if it is passed backwards. Below 2^53, for a region has less than 2^20 vertices.
  const passed = new Float64Array(indices.length);
  for (let i = 0; i < indices.length; i += 1) {
    const from = indices[i] ?? 0;
    const to = indices[i % 3 === 2 ? i - 2 : i + 1] ?? 0;
    passed[i] = from < to ? 2 * (from * count + to) : 2 * (to * count + from) + 1;
  }
  passed.sort();
  for (let i = 0; i < passed.length; ) {
    const edge = Math.floor((passed[i] ?? 0) / 2);
    let balance = 0;
    for (; i < passed.length && Math.floor((passed[i] ?? 0) / 2) === edge; i += 1) balance += (passed[i] ?? 0) % 2 === 0 ? 1 : -1;
    if (balance !== 0) yield [Math.floor(edge / count), edge % count, balance];
  }
}

/** Edges that are open in the meshes so far, by the places of their ends: those of neighbouring regions close each other. */
class Border {
  private readonly points = new Map<string, number>();
  private readonly balances = new Map<number, number>();

  add(from: Vec3, to: Vec3, times: number): void {
    const [a, b] = [this.number(from), this.number(to)];
    // Two vertices at one place are one.
    if (a === b) return;
    const edge = Math.min(a, b) * MAX_POINTS + Math.max(a, b);
    const balance = (this.balances.get(edge) ?? 0) + (a < b ? times : -times);
    if (balance === 0) this.balances.delete(edge);
    else this.balances.set(edge, balance);
  }

  get edges(): number {
    return [...this.balances.values()].reduce((sum, balance) => sum + Math.abs(balance), 0);
  }

  private number(point: Vec3): number {
    const key = point.join();
    const known = this.points.get(key);
    if (known !== undefined) return known;
    if (this.points.size === MAX_POINTS) throw new Error(`a border of more than ${MAX_POINTS} vertices`);
    this.points.set(key, this.points.size);
    return this.points.size - 1;
  }
}

const at = (points: Float64Array, vertex: number): Vec3 => [points[3 * vertex] ?? 0, points[3 * vertex + 1] ?? 0, points[3 * vertex + 2] ?? 0];
const minus = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a: Vec3, b: Vec3): Vec3 => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a: Vec3) => Math.sqrt(dot(a, a));
