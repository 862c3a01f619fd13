/** Decoder of the coding `predictive` of chunks (PROTOCOL.md, section 4.1). Pure. */

import { ChunkError, type ChunkHeader } from "../protocol/chunk";
import { Boundary, THIRD, type Third } from "./boundary";
import { type NumberModel, RangeDecoder } from "./rangeDecoder";

/** Six 16-bit words a vertex: position, both bytes of the normal, s, f̂. */
const WORDS = 6;
/** Contexts of positions, and of features. */
const SIZES = 12;
const DIFFERENCES = 10;
/** Triangles around a vertex that are told apart, at most. */
const MAX_COUNT = 7;
/** Positions that planes predict are within this. */
const MAX_PREDICTED = 65536;
/** Models of all kinds, at most. */
const MAX_MODELS = 2048;
const LEVELS = 6;

export interface PredictiveMesh {
  readonly vertices: Int16Array<ArrayBuffer>;
  readonly indices: Uint32Array<ArrayBuffer>;
}

/** @throws ChunkError when the payload is damaged */
export function decodePredictive(header: ChunkHeader, payload: Uint8Array): PredictiveMesh {
  return new PredictiveDecoder(header, payload).decode();
}

class PredictiveDecoder {
  private readonly reader: RangeDecoder;
  private readonly boundary: Boundary;
  private readonly triangles: number;
  private readonly vertices: Int16Array<ArrayBuffer>;
  /** In the order in which they come, with their levels. */
  private readonly corners: Uint32Array;
  private readonly levels: Uint8Array;
  /** Of each vertex: the sum of the cross products of its triangles, and how many these are, up to a maximum. */
  private readonly normals: Float64Array;
  private readonly counts: Uint8Array;
  private triangleCount = 0;
  private vertexCount = 0;
  private startLevel = 0;
  private readonly stack: number[] = [];

  private readonly isTriangle: number;
  private readonly isNew: number;
  private readonly isRight: number;
  private readonly isLeft: number;
  private readonly isCornerNew: number;
  private readonly isSameLevel: number;
  private readonly level: number;
  private readonly age: NumberModel;
  private readonly corner: NumberModel;
  private readonly across: NumberModel;
  private readonly depth: NumberModel;
  private readonly smoothness: NumberModel;
  private readonly feature: NumberModel;
  private readonly normal: NumberModel;

  constructor(
    private readonly header: ChunkHeader,
    payload: Uint8Array,
  ) {
    const { vertexCount, indexCount } = header;
    this.triangles = indexCount / 3;
    this.vertices = new Int16Array(WORDS * vertexCount);
    this.corners = new Uint32Array(indexCount);
    this.levels = new Uint8Array(this.triangles);
    this.normals = new Float64Array(3 * vertexCount);
    this.counts = new Uint8Array(vertexCount);
    this.boundary = new Boundary(this.triangles, vertexCount);
    const reader = (this.reader = new RangeDecoder(payload, MAX_MODELS));
    this.isTriangle = reader.addBits(4);
    [this.isNew, this.isRight, this.isLeft] = [reader.addBits(64), reader.addBits(64), reader.addBits(64)];
    this.isCornerNew = reader.addBits(3);
    this.isSameLevel = reader.addBits(4);
    this.level = reader.addBits(LEVELS * 7);
    this.age = reader.addNumber(1);
    this.corner = reader.addNumber(3);
    [this.across, this.depth] = [reader.addNumber(SIZES), reader.addNumber(SIZES)];
    [this.smoothness, this.feature] = [reader.addNumber(DIFFERENCES), reader.addNumber(DIFFERENCES)];
    this.normal = reader.addNumber(2);
  }

  decode(): PredictiveMesh {
    while (this.triangleCount < this.triangles) {
      this.start();
      for (let edge = this.stack.pop(); edge !== undefined; edge = this.stack.pop()) {
        if (this.boundary.isOpen[edge] === 1) this.follow(edge);
      }
    }
    this.check(this.vertexCount === this.header.vertexCount, `${this.vertexCount} vertices, expected ${this.header.vertexCount}`);
    this.readNormals();
    this.check(this.reader.isAtEnd, "it ends elsewhere than its mesh");
    return { vertices: this.vertices, indices: this.byLevel() };
  }

  private check(ok: boolean, what: string): asserts ok {
    if (!ok) throw new ChunkError(`mesh chunk of region (${this.header.region.join(", ")}): damaged payload: ${what}`);
  }

  /** A triangle that nothing leads to. */
  private start(): void {
    const level = (this.startLevel = this.readLevel(this.startLevel));
    const corners = [0, 1, 2].map((place) => {
      const isNew = this.reader.bit(this.isCornerNew + place);
      return isNew ? this.addCorner(place) : this.oldVertex();
    });
    const [a = 0, b = 0, c = 0] = corners;
    this.addTriangle(a, b, c, level);
    const first = this.boundary.start(a, b, c, level);
    this.stack.push(first, first + 1, first + 2);
  }

  /** The triangle behind an edge, if there is one. */
  private follow(edge: number): void {
    const { reader, boundary } = this;
    const previous = at(boundary.previous, edge);
    const next = at(boundary.next, edge);
    if (!reader.bit(this.isTriangle + at(boundary.isBorder, previous) + 2 * at(boundary.isBorder, next))) {
      boundary.isBorder[edge] = 1;
      return;
    }
    let level = at(boundary.level, edge);
    const context = (at(boundary.level, previous) === level ? 0 : 1) + (at(boundary.level, next) === level ? 0 : 2);
    if (!reader.bit(this.isSameLevel + context)) level = this.readLevel(level);
    const [from, to] = [at(boundary.from, edge), at(boundary.to, edge)];
    const third = this.readThird(at(this.counts, from) + 8 * at(this.counts, to));
    const vertex = this.thirdVertex(third, edge);
    this.addTriangle(from, to, vertex, level);
    const left = boundary.cover(edge, vertex, third, level);
    if (boundary.isOpen[left] === 1) this.stack.push(left);
    if (boundary.isOpen[left + 1] === 1) this.stack.push(left + 1);
  }

  private readThird(context: number): Third {
    if (this.reader.bit(this.isNew + context)) return THIRD.new;
    if (this.reader.bit(this.isRight + context)) return THIRD.right;
    return this.reader.bit(this.isLeft + context) ? THIRD.left : THIRD.other;
  }

  private thirdVertex(third: Third, edge: number): number {
    switch (third) {
      case THIRD.new:
        return this.addVertex(edge);
      case THIRD.right:
        return at(this.boundary.to, at(this.boundary.next, edge));
      case THIRD.left:
        return at(this.boundary.from, at(this.boundary.previous, edge));
      case THIRD.other:
        return this.oldVertex();
    }
  }

  private readLevel(before: number): number {
    let node = 1;
    for (let bit = 0; bit < 3; bit += 1) node = 2 * node + (this.reader.bit(this.level + 7 * before + node - 1) ? 1 : 0);
    this.check(node - 8 < LEVELS, `level ${node - 8}, expected 0 to ${LEVELS - 1}`);
    return node - 8;
  }

  private oldVertex(): number {
    const age = this.reader.number(this.age, 0);
    const vertex = this.vertexCount - 1 - age;
    this.check(age >= 0 && vertex >= 0, `vertex ${vertex} of ${this.vertexCount}`);
    return vertex;
  }

  private beginVertex(): number {
    this.check(this.vertexCount < this.header.vertexCount, `more than ${this.header.vertexCount} vertices`);
    this.vertexCount += 1;
    return this.vertexCount - 1;
  }

  private addTriangle(a: number, b: number, c: number, level: number): void {
    this.check(this.triangleCount < this.triangles && !this.reader.isExhausted, `more than ${this.triangles} triangles, or it ends early`);
    this.corners.set([a, b, c], 3 * this.triangleCount);
    this.levels[this.triangleCount] = level;
    this.triangleCount += 1;
    const [x, y, z] = [this.position(a, 0), this.position(a, 1), this.position(a, 2)];
    const [ux, uy, uz] = [this.position(b, 0) - x, this.position(b, 1) - y, this.position(b, 2) - z];
    const [vx, vy, vz] = [this.position(c, 0) - x, this.position(c, 1) - y, this.position(c, 2) - z];
    const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const vertex of [a, b, c]) {
      this.normals[3 * vertex] = at(this.normals, 3 * vertex) + nx;
      this.normals[3 * vertex + 1] = at(this.normals, 3 * vertex + 1) + ny;
      this.normals[3 * vertex + 2] = at(this.normals, 3 * vertex + 2) + nz;
      this.counts[vertex] = Math.min(at(this.counts, vertex) + 1, MAX_COUNT);
    }
  }

  private position(vertex: number, axis: number): number {
    return at(this.vertices, WORDS * vertex + axis);
  }

  /** A feature as it is coded: multiples of 256, and 65535. */
  private featureStep(vertex: number, word: number): number {
    const value = at(this.vertices, WORDS * vertex + word) & 0xffff;
    return (value >> 8) + (value === 0xffff ? 1 : 0);
  }

  private setFeature(vertex: number, word: number, step: number): void {
    this.check(step >= 0 && step <= 256, `feature ${step}, expected 0 to 256`);
    this.vertices[WORDS * vertex + word] = step === 256 ? 0xffff : step << 8;
  }

  /** A corner of a triangle that nothing leads to, predicted by the vertex before. */
  private addCorner(place: number): number {
    const vertex = this.beginVertex();
    for (let axis = 0; axis < 3; axis += 1) {
      const before = vertex === 0 ? 1024 : this.position(vertex - 1, axis);
      this.vertices[WORDS * vertex + axis] = before + this.reader.number(this.corner, place > 0 ? 1 : 0);
    }
    for (const word of [4, 5]) {
      const before = vertex === 0 ? 128 : this.featureStep(vertex - 1, word);
      this.setFeature(vertex, word, before + this.reader.number(this.corner, 2));
    }
    return vertex;
  }

  /** A new vertex behind an edge. */
  private addVertex(edge: number): number {
    const [a, b, o] = [at(this.boundary.from, edge), at(this.boundary.to, edge), at(this.boundary.opposite, edge)];
    const vertex = this.beginVertex();
    this.readPosition(vertex, a, b, o);
    for (const [word, model] of [[4, this.smoothness], [5, this.feature]] as const) {
      const [low, high] = [this.featureStep(a, word), this.featureStep(b, word)];
      const context = Math.min(length(low - high), DIFFERENCES - 1);
      this.setFeature(vertex, word, ((low + high) >> 1) + this.reader.number(model, context));
    }
    return vertex;
  }

  private readPosition(vertex: number, a: number, b: number, o: number): void {
    let [edge, height] = [0, 0];
    for (let axis = 0; axis < 3; axis += 1) {
      const [p, q, r] = [this.position(a, axis), this.position(b, axis), this.position(o, axis)];
      edge = Math.max(edge, Math.abs(p - q));
      height = Math.max(height, Math.abs(p + q - 2 * r));
    }
    const size = Math.min(length(edge + (height >> 1)), SIZES - 1);
    const normal = this.normalOfEdge(a, b);
    const depth = deepest(normal);
    const parallelogram = (axis: number) => (7 * (this.position(a, axis) + this.position(b, axis)) - 6 * this.position(o, axis) + 4) >> 3;
    const [x, y] = [(depth + 1) % 3, (depth + 2) % 3];
    for (const axis of [x, y]) this.vertices[WORDS * vertex + axis] = parallelogram(axis) + this.reader.number(this.across, size);
    const plane = (end: number) => {
      const rise =
        at(normal, x) * (this.position(vertex, x) - this.position(end, x)) + at(normal, y) * (this.position(vertex, y) - this.position(end, y));
      return this.position(end, depth) - rise / at(normal, depth);
    };
    const mean = Math.floor((plane(a) + plane(b)) * 0.5 + 0.5);
    // Where there is no normal it is no number.
    const predicted = Math.abs(mean) <= MAX_PREDICTED ? mean : parallelogram(depth);
    this.vertices[WORDS * vertex + depth] = predicted + this.reader.number(this.depth, size);
  }

  /** The sum of the unit normals at both ends. */
  private normalOfEdge(a: number, b: number): readonly [number, number, number] {
    const [ax, ay, az] = [at(this.normals, 3 * a), at(this.normals, 3 * a + 1), at(this.normals, 3 * a + 2)];
    const [bx, by, bz] = [at(this.normals, 3 * b), at(this.normals, 3 * b + 1), at(this.normals, 3 * b + 2)];
    const [inA, inB] = [Math.sqrt(ax * ax + ay * ay + az * az), Math.sqrt(bx * bx + by * by + bz * bz)];
    const over = (value: number, by: number) => (by > 0 ? value / by : 0);
    return [over(ax, inA) + over(bx, inB), over(ay, inA) + over(by, inB), over(az, inA) + over(bz, inB)];
  }

  /** All normals, behind everything else. */
  private readNormals(): void {
    const weights = [this.reader.raw(16), this.reader.raw(16), this.reader.raw(16)];
    const atBorder = this.boundary.borderVertices();
    for (let vertex = 0; vertex < this.vertexCount; vertex += 1) {
      const [x, y] = octahedral(
        at(this.normals, 3 * vertex) * at(weights, 0),
        at(this.normals, 3 * vertex + 1) * at(weights, 1),
        at(this.normals, 3 * vertex + 2) * at(weights, 2),
      );
      const context = at(atBorder, vertex);
      const first = x + this.reader.number(this.normal, context);
      const second = y + this.reader.number(this.normal, context);
      this.vertices[WORDS * vertex + 3] = (first & 0xff) | (second << 8);
    }
  }

  /** Finest level first, each in the order in which its triangles came. */
  private byLevel(): Uint32Array<ArrayBuffer> {
    const indices = new Uint32Array(3 * this.triangles);
    const { levelTriangles } = this.header;
    let sum = 0;
    const ends = levelTriangles.map((count) => (sum += count));
    const places = levelTriangles.map((count, level) => at(ends, level) - count);
    for (let triangle = 0; triangle < this.triangles; triangle += 1) {
      const level = at(this.levels, triangle);
      const place = at(places, level);
      this.check(place < at(ends, level), `more triangles of level ${level} than ${levelTriangles[level] ?? 0}`);
      indices.set(this.corners.subarray(3 * triangle, 3 * triangle + 3), 3 * place);
      places[level] = place + 1;
    }
    return indices;
  }
}

const at = (values: ArrayLike<number>, index: number): number => values[index] ?? 0;

/** Bits of a magnitude. */
const length = (value: number): number => 32 - Math.clz32(Math.abs(value));

/** The axis of the largest component; of equal ones the first. */
function deepest([x, y, z]: readonly [number, number, number]): number {
  const first = Math.abs(y) > Math.abs(x) ? 1 : 0;
  return Math.abs(z) > Math.max(Math.abs(x), Math.abs(y)) ? 2 : first;
}

/** Octahedral coordinates over 127, rounded. */
function octahedral(nx: number, ny: number, nz: number): readonly [number, number] {
  const sum = Math.abs(nx) + Math.abs(ny) + Math.abs(nz);
  if (sum === 0) return [0, 0];
  const [x, y] = [nx / sum, ny / sum];
  const [u, v] = nz < 0 ? [withSign(1 - Math.abs(y), x), withSign(1 - Math.abs(x), y)] : [x, y];
  return [Math.floor(u * 127 + 0.5), Math.floor(v * 127 + 0.5)];
}

const withSign = (value: number, of: number) => (of < 0 ? -value : value);
