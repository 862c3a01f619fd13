/** Region meshes of grids with uneven axes: from index space to even coordinates, in which they are drawn. Pure. */

import { differenceStepOf, evenOf, largestStep, stepOf, type Uneven } from "../world/uneven";
import type { Vec3 } from "./world";

/**
 * What made a mesh, and how its normals: `marching-cubes` from the differences at the two samples of an edge of the grid, `dual` from the gradient
 * of the interpolant in a cell.
 */
export type Mesher = "dual" | "marching-cubes";

/** What is moved of a region mesh. */
interface InIndexSpace {
  /** Six words a vertex: position, packed normal, features. */
  readonly vertices: Int16Array;
  /** Index coordinates of position 0, and position units per index step. */
  readonly corner: Vec3;
  readonly lattice: number;
  readonly mesher: Mesher;
  readonly bounds: { readonly min: Vec3; readonly max: Vec3 };
}

const WORDS = 6;

/** Positions of the vertices, three floats each. Normals in the words, which are made in cells of the largest lengths, are turned. */
export function inEvenCoordinates({ vertices, corner, lattice, mesher, bounds }: InIndexSpace, axes: Uneven): { readonly positions: Float32Array<ArrayBuffer>; readonly bounds: InIndexSpace["bounds"] } {
  const count = vertices.length / WORDS;
  const positions = new Float32Array(3 * count);
  const largest = axes.map(largestStep);
  const gradientStepOf = mesher === "marching-cubes" ? differenceStepOf : stepOf;
  for (let i = 0; i < count; i += 1) {
    const steps: number[] = [];
    for (const axis of [0, 1, 2] as const) {
      const index = corner[axis] + (vertices[WORDS * i + axis] ?? 0) / lattice;
      positions[3 * i + axis] = evenOf(axes[axis], index);
      steps.push((largest[axis] ?? 1) / gradientStepOf(axes[axis], index));
    }
    const normal = unpack(vertices[WORDS * i + 3] ?? 0);
    vertices[WORDS * i + 3] = pack([normal[0] * (steps[0] ?? 1), normal[1] * (steps[1] ?? 1), normal[2] * (steps[2] ?? 1)]);
  }
  const even = (p: Vec3): Vec3 => [evenOf(axes[0], p[0]), evenOf(axes[1], p[1]), evenOf(axes[2], p[2])];
  return { positions, bounds: { min: even(bounds.min), max: even(bounds.max) } };
}

const folded = (x: number, y: number): [number, number] => [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];

/** Two signed bytes, octahedral, over 127, x low. */
export function unpack(word: number): Vec3 {
  let [x, y] = [Math.max(((word << 24) >> 24) / 127, -1), Math.max(((word << 16) >> 24) / 127, -1)];
  const z = 1 - Math.abs(x) - Math.abs(y);
  if (z < 0) [x, y] = folded(x, y);
  return [x, y, z];
}

/** As `unpack` reads it, signed; of a vector of any length. */
export function pack([x, y, z]: Vec3): number {
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  if (sum === 0) return 0;
  let [u, v] = [x / sum, y / sum];
  if (z < 0) [u, v] = folded(u, v);
  const word = (Math.round(u * 127) & 0xff) | ((Math.round(v * 127) & 0xff) << 8);
  return (word << 16) >> 16;
}
