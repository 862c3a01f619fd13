/** Decoder of the coding `predictive` of chunks (PROTOCOL.md, section 4.1). Pure. */

import { ChunkError, type ChunkHeader } from "../protocol/chunk";
import { Boundary, THIRD, type Third } from "./boundary";
import { type NumberModel, RangeDecoder } from "./rangeDecoder";

/** Six 16-bit words a vertex: position, both bytes of the normal, s, f̂. */
const WORDS = 6;
/** Contexts of positions, and of features. */
const SIZES = 12;
const DIFFERENCES = 10;
/** Maximum number of triangles around a vertex that are distinguished. */
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
  /** Corners of the triangles in the order of decoding, with their levels. */
  private readonly corners: Uint32Array;
  private readonly levels: Uint8Array;
  /** Of each vertex: the sum of the cross products of its triangles, and how many these are, up to a maximum. */
  private readonly normals: Float64Array;
  private readonly counts: Uint8Array;
  private readonly edgeNormal = new Float64Array(3);
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

  /** Decodes a triangle that shares no decoded edge. */
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
    const previous = int(boundary.previous, edge);
    const next = int(boundary.next, edge);
    if (!reader.bit(this.isTriangle + byte(boundary.isBorder, previous) + 2 * byte(boundary.isBorder, next))) {
      boundary.isBorder[edge] = 1;
      return;
    }
    let level = byte(boundary.level, edge);
    const context = (byte(boundary.level, previous) === level ? 0 : 1) + (byte(boundary.level, next) === level ? 0 : 2);
    if (!reader.bit(this.isSameLevel + context)) level = this.readLevel(level);
    const from = int(boundary.from, edge);
    const to = int(boundary.to, edge);
    const third = this.readThird(byte(this.counts, from) + 8 * byte(this.counts, to));
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
        return int(this.boundary.to, int(this.boundary.next, edge));
      case THIRD.left:
        return int(this.boundary.from, int(this.boundary.previous, edge));
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
    const first = 3 * this.triangleCount;
    this.corners[first] = a;
    this.corners[first + 1] = b;
    this.corners[first + 2] = c;
    this.levels[this.triangleCount] = level;
    this.triangleCount += 1;
    const x = this.position(a, 0);
    const y = this.position(a, 1);
    const z = this.position(a, 2);
    const ux = this.position(b, 0) - x;
    const uy = this.position(b, 1) - y;
    const uz = this.position(b, 2) - z;
    const vx = this.position(c, 0) - x;
    const vy = this.position(c, 1) - y;
    const vz = this.position(c, 2) - z;
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    this.addNormal(a, nx, ny, nz);
    this.addNormal(b, nx, ny, nz);
    this.addNormal(c, nx, ny, nz);
  }

  private addNormal(vertex: number, x: number, y: number, z: number): void {
    const first = 3 * vertex;
    this.normals[first] = float(this.normals, first) + x;
    this.normals[first + 1] = float(this.normals, first + 1) + y;
    this.normals[first + 2] = float(this.normals, first + 2) + z;
    this.counts[vertex] = Math.min(byte(this.counts, vertex) + 1, MAX_COUNT);
  }

  private position(vertex: number, axis: number): number {
    return word(this.vertices, WORDS * vertex + axis);
  }

  /** A feature as it is coded: multiples of 256, and 65535. */
  private featureStep(vertex: number, place: number): number {
    const value = word(this.vertices, WORDS * vertex + place) & 0xffff;
    return (value >> 8) + (value === 0xffff ? 1 : 0);
  }

  private setFeature(vertex: number, place: number, step: number): void {
    this.check(step >= 0 && step <= 256, `feature ${step}, expected 0 to 256`);
    this.vertices[WORDS * vertex + place] = step === 256 ? 0xffff : step << 8;
  }

  /** A corner of a triangle that shares no decoded edge, predicted by the previous vertex. */
  private addCorner(place: number): number {
    const vertex = this.beginVertex();
    for (let axis = 0; axis < 3; axis += 1) {
      const before = vertex === 0 ? 1024 : this.position(vertex - 1, axis);
      this.vertices[WORDS * vertex + axis] = before + this.reader.number(this.corner, place > 0 ? 1 : 0);
    }
    for (const place of [4, 5]) {
      const before = vertex === 0 ? 128 : this.featureStep(vertex - 1, place);
      this.setFeature(vertex, place, before + this.reader.number(this.corner, 2));
    }
    return vertex;
  }

  /** A new vertex behind an edge. */
  private addVertex(edge: number): number {
    const a = int(this.boundary.from, edge);
    const b = int(this.boundary.to, edge);
    const vertex = this.beginVertex();
    this.readPosition(vertex, a, b, int(this.boundary.opposite, edge));
    this.readFeature(vertex, a, b, 4, this.smoothness);
    this.readFeature(vertex, a, b, 5, this.feature);
    return vertex;
  }

  private readFeature(vertex: number, a: number, b: number, place: number, model: NumberModel): void {
    const low = this.featureStep(a, place);
    const high = this.featureStep(b, place);
    const context = Math.min(length(low - high), DIFFERENCES - 1);
    this.setFeature(vertex, place, ((low + high) >> 1) + this.reader.number(model, context));
  }

  private readPosition(vertex: number, a: number, b: number, o: number): void {
    let edge = 0;
    let height = 0;
    for (let axis = 0; axis < 3; axis += 1) {
      const p = this.position(a, axis);
      const q = this.position(b, axis);
      edge = Math.max(edge, Math.abs(p - q));
      height = Math.max(height, Math.abs(p + q - 2 * this.position(o, axis)));
    }
    const size = Math.min(length(edge + (height >> 1)), SIZES - 1);
    this.setEdgeNormal(a, b);
    const normal = this.edgeNormal;
    const depth = deepest(normal);
    const x = (depth + 1) % 3;
    const y = (depth + 2) % 3;
    const first = WORDS * vertex;
    this.vertices[first + x] = this.parallelogram(a, b, o, x) + this.reader.number(this.across, size);
    this.vertices[first + y] = this.parallelogram(a, b, o, y) + this.reader.number(this.across, size);
    const mean = Math.floor((this.inPlane(vertex, a, x, y, depth) + this.inPlane(vertex, b, x, y, depth)) * 0.5 + 0.5);
    // If there is no normal, `mean` is not a number, and the comparison is false.
    const predicted = Math.abs(mean) <= MAX_PREDICTED ? mean : this.parallelogram(a, b, o, depth);
    this.vertices[first + depth] = predicted + this.reader.number(this.depth, size);
  }

  private parallelogram(a: number, b: number, o: number, axis: number): number {
    return (7 * (this.position(a, axis) + this.position(b, axis)) - 6 * this.position(o, axis) + 4) >> 3;
  }

  /** Coordinate along the axis `depth`, at a vertex' `x` and `y`, of the plane through one end of the edge. */
  private inPlane(vertex: number, end: number, x: number, y: number, depth: number): number {
    const { edgeNormal: normal } = this;
    const rise =
      float(normal, x) * (this.position(vertex, x) - this.position(end, x)) + float(normal, y) * (this.position(vertex, y) - this.position(end, y));
    return this.position(end, depth) - rise / float(normal, depth);
  }

  /** The sum of the unit normals at both ends. */
  private setEdgeNormal(a: number, b: number): void {
    const { normals } = this;
    const inA = this.normalLength(a);
    const inB = this.normalLength(b);
    for (let axis = 0; axis < 3; axis += 1) {
      const ofA = inA > 0 ? float(normals, 3 * a + axis) / inA : 0;
      const ofB = inB > 0 ? float(normals, 3 * b + axis) / inB : 0;
      this.edgeNormal[axis] = ofA + ofB;
    }
  }

  private normalLength(vertex: number): number {
    const x = float(this.normals, 3 * vertex);
    const y = float(this.normals, 3 * vertex + 1);
    const z = float(this.normals, 3 * vertex + 2);
    return Math.sqrt(x * x + y * y + z * z);
  }

  /** Reads all normals, which follow all other data. */
  private readNormals(): void {
    const weights = [this.reader.raw(16), this.reader.raw(16), this.reader.raw(16)];
    const atBorder = this.boundary.borderVertices();
    for (let vertex = 0; vertex < this.vertexCount; vertex += 1) {
      const [x, y] = octahedral(
        float(this.normals, 3 * vertex) * (weights[0] ?? 0),
        float(this.normals, 3 * vertex + 1) * (weights[1] ?? 0),
        float(this.normals, 3 * vertex + 2) * (weights[2] ?? 0),
      );
      const context = byte(atBorder, vertex);
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
    const places = levelTriangles.map((count, level) => (ends[level] ?? 0) - count);
    for (let triangle = 0; triangle < this.triangles; triangle += 1) {
      const level = byte(this.levels, triangle);
      const place = (places[level] ?? 0);
      this.check(place < (ends[level] ?? 0), `more triangles of level ${level} than ${levelTriangles[level] ?? 0}`);
      indices.set(this.corners.subarray(3 * triangle, 3 * triangle + 3), 3 * place);
      places[level] = place + 1;
    }
    return indices;
  }
}

// One function for each type of array: otherwise the engine looks up the type at each access.
const int = (values: Int32Array, index: number): number => values[index] ?? 0;
const byte = (values: Uint8Array, index: number): number => values[index] ?? 0;
const word = (values: Int16Array, index: number): number => values[index] ?? 0;
const float = (values: Float64Array, index: number): number => values[index] ?? 0;

/** Bits of a magnitude. */
const length = (value: number): number => 32 - Math.clz32(Math.abs(value));

/** The axis of the largest component; of equal ones the first. */
function deepest(normal: Float64Array): number {
  const x = Math.abs(float(normal, 0));
  const y = Math.abs(float(normal, 1));
  return Math.abs(float(normal, 2)) > Math.max(x, y) ? 2 : y > x ? 1 : 0;
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
