/**
 * Averages the values that colour a surface over the neighbours of each vertex. Pure.
 *
 * `s` and `f̂` are values of the cubes that a cut ends at, and jump where neighbouring cubes differ in size or place: drawn as they are,
 * they speckle the picture with triangles of the wrong colour. Averaged over some rings they show what they tell of: how the shape and
 * the feature change over the surface.
 */

/** Words of a vertex, and where in it the values are. */
const STRIDE = 6;
const FIRST = 4;
const CHANNELS = 2;

/** Each round reaches one ring farther. Six of them blur over some four cells of the finest level. */
const ROUNDS = 6;

/**
 * Averages in place. A vertex on the region's edge is averaged along the edge alone, which both of its regions know, so that no seam is
 * seen between them.
 * @param vertices six 16-bit words a vertex, the values in the last two, unsigned
 */
export function smoothFeatures(vertices: Int16Array, indices: Uint16Array | Uint32Array, rounds = ROUNDS): void {
  const count = vertices.length / STRIDE;
  const words = new Uint16Array(vertices.buffer, vertices.byteOffset, vertices.length);
  const boundary = boundaryEdges(indices, count);
  const triangles = new Uint16Array(count);
  for (let i = 0; i < indices.length; i += 1) triangles[indices[i] ?? 0] = (triangles[indices[i] ?? 0] ?? 0) + 1;
  for (let channel = FIRST; channel < FIRST + CHANNELS; channel += 1) {
    let values = new Float32Array(count);
    for (let v = 0; v < count; v += 1) values[v] = words[STRIDE * v + channel] ?? 0;
    for (let round = 0; round < rounds; round += 1) values = average(values, indices, triangles, boundary);
    for (let v = 0; v < count; v += 1) words[STRIDE * v + channel] = Math.round(values[v] ?? 0);
  }
}

interface Boundary {
  /** Pairs of vertices. */
  readonly edges: readonly number[];
  /** The vertices on it. */
  readonly on: readonly number[];
}

/** Edges of one triangle alone. */
function boundaryEdges(indices: Uint16Array | Uint32Array, count: number): Boundary {
  // Around a vertex inside, each neighbour stands in two triangles: their exclusive or is 0.
  const ring = new Uint32Array(count);
  for (let i = 0; i < indices.length; i += 3) {
    const a = indices[i] ?? 0;
    const b = indices[i + 1] ?? 0;
    const c = indices[i + 2] ?? 0;
    ring[a] = (ring[a] ?? 0) ^ b ^ c;
    ring[b] = (ring[b] ?? 0) ^ a ^ c;
    ring[c] = (ring[c] ?? 0) ^ a ^ b;
  }
  const on: number[] = [];
  for (let v = 0; v < count; v += 1) if (ring[v] !== 0) on.push(v);
  const once = new Map<number, readonly [number, number]>();
  for (let i = 0; i < indices.length; i += 1) {
    const a = indices[i] ?? 0;
    if (ring[a] === 0) continue;
    const b = indices[i % 3 === 2 ? i - 2 : i + 1] ?? 0;
    if (ring[b] === 0) continue;
    const key = Math.min(a, b) * count + Math.max(a, b);
    if (!once.delete(key)) once.set(key, [a, b]);
  }
  return { edges: [...once.values()].flat(), on };
}

/** One round: the mean of each vertex, counted as two, and of its neighbours, each counted once a triangle. */
function average(values: Float32Array, indices: Uint16Array | Uint32Array, triangles: Uint16Array, boundary: Boundary): Float32Array<ArrayBuffer> {
  const means = new Float32Array(values.length);
  for (let i = 0; i < indices.length; i += 3) {
    const a = indices[i] ?? 0;
    const b = indices[i + 1] ?? 0;
    const c = indices[i + 2] ?? 0;
    const sum = (values[a] ?? 0) + (values[b] ?? 0) + (values[c] ?? 0);
    means[a] = (means[a] ?? 0) + sum;
    means[b] = (means[b] ?? 0) + sum;
    means[c] = (means[c] ?? 0) + sum;
  }
  for (let v = 0; v < values.length; v += 1) {
    // Each triangle's sum has the vertex itself too.
    const around = triangles[v] ?? 0;
    means[v] = ((means[v] ?? 0) + (2 - around) * (values[v] ?? 0)) / (2 * around + 2);
  }
  averageBoundary(values, boundary, means);
  return means;
}

/** The same for vertices on the boundary, of which only neighbours along it count. */
function averageBoundary(values: Float32Array, { edges, on }: Boundary, means: Float32Array): void {
  const weights = new Float32Array(values.length);
  for (const v of on) {
    means[v] = 2 * (values[v] ?? 0);
    weights[v] = 2;
  }
  for (let i = 0; i < edges.length; i += 2) {
    const [a, b] = [edges[i] ?? 0, edges[i + 1] ?? 0];
    means[a] = (means[a] ?? 0) + (values[b] ?? 0);
    means[b] = (means[b] ?? 0) + (values[a] ?? 0);
    weights[a] = (weights[a] ?? 0) + 1;
    weights[b] = (weights[b] ?? 0) + 1;
  }
  for (const v of on) means[v] = (means[v] ?? 0) / (weights[v] ?? 2);
}
