/** A synthetic surface for the fixture server: naive surface nets over a function, cut in regions, encoded as mesh chunks. */

import { MeshoptEncoder } from "meshoptimizer/encoder";
import { HEADER_BYTES, VERTEX_BYTES } from "../src/protocol/chunk";
import { LEVELS, REGION_CELLS } from "../src/protocol/generated";

export const CELLS = 64;
const LATTICE = 256;

export type Field = (x: number, y: number, z: number) => number;

/** A wobbly ball: positive inside, 0 near radius 24, over the 65³ samples of the volume. */
export function wobblyBall(step: number): Field {
  return (x, y, z) => {
    const [u, v, w] = [x - CELLS / 2, y - CELLS / 2, z - CELLS / 2];
    const k = 0.24;
    const gyroid =
      Math.sin(k * u) * Math.cos(k * v) + Math.sin(k * v) * Math.cos(k * w) + Math.sin(k * w) * Math.cos(k * u);
    return 24 + step + 3 * gyroid - Math.hypot(u, v, w);
  };
}

/** Importance of a point, 0 to 1: high near the top. */
export const feature: Field = (_x, _y, z) => Math.min(1, Math.max(0, (z - 12) / 40));

export interface SyntheticMesh {
  readonly region: readonly [number, number, number];
  /** Of the region; 0 if left out. */
  readonly size?: number;
  /** Index space, three a vertex. */
  readonly positions: number[];
  /** Unit normals towards lower values. */
  readonly normals: number[];
  readonly s: number[];
  readonly f: number[];
  /** Three per triangle, finest level first. */
  readonly indices: number[];
  readonly levelTriangles: number[];
}

interface NetVertex {
  readonly p: readonly [number, number, number];
  readonly n: readonly [number, number, number];
  readonly s: number;
  readonly f: number;
}

interface Triangle {
  readonly corners: readonly [NetVertex, NetVertex, NetVertex];
  readonly level: number;
}

type Index = readonly [number, number, number];

/** A function sampled at the corners of cells of 2^level, and a vertex for each cell that the surface crosses. */
class Net {
  /** Cells along an axis. */
  readonly cells: number;
  private readonly h: number;
  private readonly values: Float64Array;
  private readonly vertices = new Map<number, NetVertex>();

  constructor(
    private readonly field: Field,
    iso: number,
    level: number,
  ) {
    const h = 2 ** level;
    const n = CELLS / h;
    this.h = h;
    this.cells = n;
    this.values = new Float64Array((n + 1) ** 3);
    for (let k = 0; k <= n; k += 1)
      for (let j = 0; j <= n; j += 1)
        for (let i = 0; i <= n; i += 1) this.values[this.at([i, j, k])] = field(i * h, j * h, k * h) - iso;
  }

  value(index: Index): number {
    return this.values[this.at(index)] ?? 0;
  }

  /** The vertex of the cell with this lowest corner. */
  vertex(cell: Index): NetVertex {
    const known = this.vertices.get(this.at(cell));
    if (known !== undefined) return known;
    const p = this.meanCrossing(cell);
    const made: NetVertex = {
      p,
      n: this.normal(p),
      s: 0.5 * Math.abs(Math.sin(0.2 * p[0]) * Math.cos(0.17 * p[1])),
      f: feature(...p),
    };
    this.vertices.set(this.at(cell), made);
    return made;
  }

  private at([i, j, k]: Index): number {
    return i + (this.cells + 1) * (j + (this.cells + 1) * k);
  }

  /** Mean of the crossings of a cell's edges. */
  private meanCrossing(cell: Index): Index {
    const sum: [number, number, number] = [0, 0, 0];
    let crossings = 0;
    for (let axis = 0; axis < 3; axis += 1) {
      for (let corner = 0; corner < 4; corner += 1) {
        const a: [number, number, number] = [...cell];
        a[(axis + 1) % 3]! += corner & 1;
        a[(axis + 2) % 3]! += corner >> 1;
        const b: [number, number, number] = [...a];
        b[axis]! += 1;
        const [va, vb] = [this.value(a), this.value(b)];
        if (va >= 0 === vb >= 0) continue;
        const t = va / (va - vb);
        for (let i = 0; i < 3; i += 1) sum[i]! += a[i]! + t * (b[i]! - a[i]!);
        crossings += 1;
      }
    }
    return [(this.h * sum[0]) / crossings, (this.h * sum[1]) / crossings, (this.h * sum[2]) / crossings];
  }

  /** Towards lower values. */
  private normal([x, y, z]: Index): Index {
    const e = 0.5;
    const g = [
      this.field(x - e, y, z) - this.field(x + e, y, z),
      this.field(x, y - e, z) - this.field(x, y + e, z),
      this.field(x, y, z - e) - this.field(x, y, z + e),
    ] as const;
    const length = Math.hypot(...g) || 1;
    return [g[0] / length, g[1] / length, g[2] / length];
  }
}

/** The four vertices around the edge from a corner along an axis, in the order of their polygon; none without a crossing. */
function quad(net: Net, corner: Index, axis: number): [NetVertex, NetVertex, NetVertex, NetVertex] | undefined {
  const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
  if (corner[u] === 0 || corner[v] === 0) return undefined;
  const next: [number, number, number] = [...corner];
  next[axis]! += 1;
  const inside = net.value(corner) >= 0;
  if (inside === net.value(next) >= 0) return undefined;
  const around = [0, 1, 3, 2].map((c) => {
    const cell: [number, number, number] = [...corner];
    cell[u]! -= c & 1;
    cell[v]! -= c >> 1;
    return net.vertex(cell);
  }) as [NetVertex, NetVertex, NetVertex, NetVertex];
  return inside ? around : ([...around].reverse() as typeof around);
}

/** Surface nets with cells of 2^level, one mesh a region; a quad belongs to the region of its lowest cell. */
export function surfaceNets(field: Field, iso: number, level: number): SyntheticMesh[] {
  const net = new Net(field, iso, level);
  const regions = new Map<string, { region: Index; triangles: Triangle[] }>();
  for (let k = 0; k < net.cells; k += 1)
    for (let j = 0; j < net.cells; j += 1)
      for (let i = 0; i < net.cells; i += 1)
        for (let axis = 0; axis < 3; axis += 1) {
          const found = quad(net, [i, j, k], axis);
          if (found === undefined) continue;
          const [a, b, c, d] = found;
          const lowest = (index: number, of: number) => Math.floor(((index - (of === axis ? 0 : 1)) * 2 ** level) / REGION_CELLS);
          const region: Index = [lowest(i, 0), lowest(j, 1), lowest(k, 2)];
          const entry = regions.get(region.join()) ?? { region, triangles: [] };
          regions.set(region.join(), entry);
          // Not a real cut; the levels are made up.
          const tag = Math.min(LEVELS - 1, Math.max(level, Math.floor((0.5 - a.s) * 8)));
          entry.triangles.push({ corners: [a, b, c], level: tag }, { corners: [a, c, d], level: tag });
        }
  return [...regions.values()].map(({ region, triangles }) => indexed(region, triangles));
}

/** The triangles with shared vertices, finest level first. */
function indexed(region: Index, triangles: Triangle[]): SyntheticMesh {
  triangles.sort((a, b) => a.level - b.level);
  const levelTriangles = Array.from({ length: LEVELS }, (_, l) => triangles.filter((t) => t.level === l).length);
  const mesh: SyntheticMesh = { region, positions: [], normals: [], s: [], f: [], indices: [], levelTriangles };
  const indexOf = new Map<NetVertex, number>();
  for (const corner of triangles.flatMap(({ corners }) => corners)) {
    let index = indexOf.get(corner);
    if (index === undefined) {
      index = indexOf.size;
      indexOf.set(corner, index);
      mesh.positions.push(...corner.p);
      mesh.normals.push(...corner.n);
      mesh.s.push(corner.s);
      mesh.f.push(corner.f);
    }
    mesh.indices.push(index);
  }
  return mesh;
}

/** Octahedral normal, two signed bytes. */
export function octahedral([x, y, z]: readonly [number, number, number]): [number, number] {
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let [u, v] = [x / sum, y / sum];
  if (z < 0) [u, v] = [(1 - Math.abs(v)) * (u < 0 ? -1 : 1), (1 - Math.abs(u)) * (v < 0 ? -1 : 1)];
  return [Math.round(127 * u), Math.round(127 * v)];
}

/** The chunk with a distance of each vertex of a mesh. */
export function encodeDistances(mesh: SyntheticMesh, distances: readonly number[], generation: number, surface = 0): Uint8Array<ArrayBuffer> {
  const frame = new Uint8Array(HEADER_BYTES + 4 * distances.length);
  frame.set(encodeChunk(mesh, generation, 0, surface).subarray(0, HEADER_BYTES));
  frame.set(new Uint8Array(Float32Array.from(distances).buffer), HEADER_BYTES);
  const header = new DataView(frame.buffer);
  header.setUint8(13, 1);
  header.setUint32(64, 4 * distances.length, true);
  header.setUint32(68, 0, true);
  return frame;
}

/** One mesh chunk; a mesh without indices gives the chunk that empties its region. `MeshoptEncoder.ready` must be awaited before. */
export function encodeChunk(mesh: SyntheticMesh, generation: number, level: number, surface = 0): Uint8Array<ArrayBuffer> {
  const count = mesh.positions.length / 3;
  const raw = new DataView(new ArrayBuffer(count * VERTEX_BYTES));
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < count; i += 1) {
    const at = i * VERTEX_BYTES;
    for (let axis = 0; axis < 3; axis += 1) {
      const p = mesh.positions[3 * i + axis]!;
      low[axis] = Math.min(low[axis]!, p);
      high[axis] = Math.max(high[axis]!, p);
      raw.setInt16(at + 2 * axis, Math.round((p - REGION_CELLS * mesh.region[axis]!) * LATTICE), true);
    }
    const [u, v] = octahedral([mesh.normals[3 * i]!, mesh.normals[3 * i + 1]!, mesh.normals[3 * i + 2]!]);
    raw.setInt8(at + 6, u);
    raw.setInt8(at + 7, v);
    raw.setUint16(at + 8, Math.round(mesh.s[i]! * 65535), true);
    raw.setUint16(at + 10, Math.round(mesh.f[i]! * 65535), true);
  }
  const vertexBytes =
    count === 0
      ? new Uint8Array(0)
      : MeshoptEncoder.encodeVertexBufferLevel(new Uint8Array(raw.buffer), count, VERTEX_BYTES, 2, 1);
  const indexBytes =
    count === 0
      ? new Uint8Array(0)
      : MeshoptEncoder.encodeIndexBuffer(new Uint8Array(Uint32Array.from(mesh.indices).buffer), mesh.indices.length, 4);

  const frame = new Uint8Array(HEADER_BYTES + vertexBytes.length + indexBytes.length);
  const header = new DataView(frame.buffer);
  frame.set(new TextEncoder().encode("ISOP"), 0);
  header.setUint16(4, 3, true);
  header.setUint16(6, HEADER_BYTES, true);
  header.setUint32(8, generation, true);
  header.setUint8(12, level);
  header.setUint8(14, surface);
  header.setUint16(16, LATTICE, true);
  header.setUint16(18, mesh.size ?? 0, true);
  mesh.region.forEach((r, axis) => header.setUint32(20 + 4 * axis, r, true));
  if (count > 0) {
    low.forEach((p, axis) => header.setFloat32(32 + 4 * axis, p, true));
    high.forEach((p, axis) => header.setFloat32(44 + 4 * axis, p, true));
  }
  header.setUint32(56, count, true);
  header.setUint32(60, mesh.indices.length, true);
  header.setUint32(64, vertexBytes.length, true);
  header.setUint32(68, indexBytes.length, true);
  mesh.levelTriangles.forEach((n, l) => header.setUint32(72 + 4 * l, n, true));
  frame.set(vertexBytes, HEADER_BYTES);
  frame.set(indexBytes, HEADER_BYTES + vertexBytes.length);
  return frame;
}
