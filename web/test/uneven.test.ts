import { describe, expect, test } from "vitest";
import { MeshSummation } from "../src/decode/meshSums";
import type { RegionMeshData } from "../src/scene/regionMesh";
import { sliceGeometry } from "../src/scene/slices";
import { inEvenCoordinates, pack, unpack } from "../src/scene/unevenMesh";
import type { Vec3 } from "../src/scene/world";
import { lengthScale } from "../src/state/lengths";
import { differenceStepOf, evenOf, largestStep, stepOf, unevenOf, type Uneven } from "../src/world/uneven";
import { VOLUMES } from "./fixture";

/** Positions along z: 0, 1, 3 and 12, of which the mean step is 4. */
const AXES: Uneven = [null, null, [0, 0.25, 0.75, 3]];

test("positions of a volume are those of an even grid in its steps", () => {
  expect(unevenOf({ spacing: [1, 2, 4], positions: [null, null, [0, 1, 3, 12]] })).toEqual(AXES);
  expect(unevenOf({ spacing: [1, 2, 4] })).toBeUndefined();
  expect([0, 0.5, 1.5, 2, 3, -2, 4.5].map((index) => evenOf(AXES[2], index))).toEqual([0, 0.125, 0.5, 0.75, 3, -2, 4.5]);
  expect([0, 1.5, 3, 3.5].map((index) => stepOf(AXES[2], index))).toEqual([0.25, 0.5, 2.25, 1]);
  expect([0, 1, 2, 3, 0.5, 1.75, 3.5].map((index) => differenceStepOf(AXES[2], index))).toEqual([0.25, 0.375, 1.375, 2.25, 0.3125, 1.125, 1]);
  expect(differenceStepOf(null, 7.5)).toBe(1);
  expect([largestStep(AXES[2]), largestStep(null), evenOf(null, 7.5), stepOf(null, 7)]).toEqual([2.25, 1, 7.5, 1]);
});

test("errors are in voxels of the largest cells", () => {
  const [volume] = VOLUMES;
  if (volume === undefined) throw new Error("a volume expected");
  const geometry = { ...volume.geometry, spacing: [20, 30, 4] as [number, number, number], positions: [null, null, [0, 1, 3, 12]] as [null, null, number[]] };
  expect(lengthScale({ geometry }).spacing).toBe(9);
});

describe("a region mesh in even coordinates", () => {
  const normal: Vec3 = [0.6, 0, 0.8];
  const meshAt = (z: number): RegionMeshData => ({
    vertices: Int16Array.from([64, 96, 64 * z, pack(normal), 7, 8]),
    indices: Uint16Array.from([0, 0, 0]),
    levelTriangles: [1],
    corner: [32, 0, 0],
    lattice: 64,
    mesher: "dual" as const,
    surface: 0,
    bounds: { min: [33, 1.5, z], max: [33, 1.5, z] },
  });
  const direction = ([x, y, z]: Vec3) => [x, y, z].map((c) => c / Math.hypot(x, y, z));

  test("has its vertices where the samples are", () => {
    const { positions, bounds } = inEvenCoordinates(meshAt(1.5), AXES);
    expect([...positions]).toEqual([33, 1.5, 0.5]);
    expect(bounds).toEqual({ min: [33, 1.5, 0.5], max: [33, 1.5, 0.5] });
  });

  test("has steeper gradients where cells are shorter", () => {
    for (const [z, ratio] of [[2.5, 1], [1.5, 4.5], [0.5, 9]] as const) {
      const mesh = meshAt(z);
      inEvenCoordinates(mesh, AXES);
      const expected = direction([normal[0], normal[1], normal[2] * ratio]);
      direction(unpack(mesh.vertices[3] ?? 0)).forEach((c, i) => expect(c).toBeCloseTo(expected[i] ?? 0, 1));
      expect([...mesh.vertices.slice(4)]).toEqual([7, 8]);
    }
  });
});

test("normals of marching cubes are exact on a plane", () => {
  // x + z in even coordinates. The server's gradient: central differences, one-sided at the ends, linear along an edge, in the largest cells.
  const [z, largest] = [[0, 0.25, 0.75, 3], 2.25];
  const gradientAt = (i: number) => ((z[Math.min(i + 1, 3)] ?? 0) - (z[Math.max(i - 1, 0)] ?? 0)) / (Math.min(i + 1, 3) - Math.max(i - 1, 0)) / largest;
  // On edges along x and y at each sample, then on edges along z.
  const onEdges = [0, 1, 2, 3].flatMap((i) => [[0.5, 1, i, 0], [1, 0.25, i, 0]]).concat([0, 1, 2].flatMap((i) => [[1, 2, i, 0.25], [1, 2, i, 0.75]]));
  for (const [x = 0, y = 0, low = 0, t = 0] of onEdges) {
    const slope = (1 - t) * gradientAt(low) + (t > 0 ? t * gradientAt(low + 1) : 0);
    const vertices = Int16Array.from([64 * x, 64 * y, 64 * (low + t), pack([-1, 0, -slope]), 0, 0]);
    inEvenCoordinates({ vertices, corner: [0, 0, 0], lattice: 64, mesher: "marching-cubes", bounds: { min: [0, 0, 0], max: [1, 2, 3] } }, AXES);
    const [a, b, c] = unpack(vertices[3] ?? 0);
    const degrees = (Math.acos(Math.min(1, -(a + c) / Math.SQRT2 / Math.hypot(a, b, c))) * 180) / Math.PI;
    // Of the rounding to bytes: half of 1/127 of a slope of 0.11, and as much again of one of 1.
    expect(degrees).toBeLessThan(1.4);
  }
});

test("normals of the dual mesher are of their own cells, at the volume's edges too", () => {
  const slope = 0.5 / 2.25;
  // In cells, and one that was moved to an edge of the volume.
  const at = [[0.5, 0.5, 1.5], [1.25, 0.5, 1.25], [0, 0, 1.75]];
  const vertices = Int16Array.from(at.flatMap((p) => [...p.map((c) => 64 * c), pack([-1, 0, -slope]), 0, 0]));
  inEvenCoordinates({ vertices, corner: [0, 0, 0], lattice: 64, mesher: "dual", bounds: { min: [0, 0, 1], max: [2, 1, 2] } }, AXES);
  for (const i of [0, 1, 2]) {
    const [a, b, c] = unpack(vertices[6 * i + 3] ?? 0);
    expect(-(a + c) / Math.SQRT2 / Math.hypot(a, b, c)).toBeGreaterThan(Math.cos((1.4 * Math.PI) / 180));
  }
});

test("normals are packed as they are unpacked", () => {
  for (let i = 0; i < 65536; i += 7) {
    const word = (i << 16) >> 16;
    const [x, y] = [(word << 24) >> 24, (word << 16) >> 24];
    // On the fold there are two ways to write a normal, and −128 is −127.
    if (Math.abs(x) + Math.abs(y) >= 127 && (x <= 0 || y <= 0)) continue;
    expect(pack(unpack(word))).toBe(word);
  }
  for (const z of [-0.9, -0.2]) for (const [x, y] of [[0.3, 0.1], [-0.3, 0.1], [-0.3, -0.2], [0.3, -0.2]] as const) {
    const [a, b, c] = unpack(pack([x, y, z]));
    const length = Math.hypot(a, b, c) / Math.hypot(x, y, z);
    expect([a / length, b / length, c / length].map((v, i) => Math.abs(v - [x, y, z][i]!) < 0.02)).toEqual([true, true, true]);
  }
});

test("area and volume are those of the moved surface", () => {
  // A box of the world, 0 to 1 along x and y, and the two lowest cells along z.
  const high: Vec3 = [1, 1, 2];
  const corner = (i: number): Vec3 => [(i & 1) * high[0], ((i >> 1) & 1) * high[1], (i >> 2) * high[2]];
  const faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
  const indices = faces.flatMap(([a = 0, b = 0, c = 0, d = 0]) => [a, b, c, a, c, d]);
  const vertices = Int16Array.from(Array.from({ length: 8 }, (_, i) => [...corner(i).map((n) => 64 * n), 0, 0, 0]).flat());
  const summation = new MeshSummation([[1, 0, 0], [0, 1, 0], [0, 0, 4]], AXES);
  summation.add({ vertices, indices: Uint16Array.from(indices), region: [0, 0, 0], lattice: 64 });
  expect(summation.sums).toEqual({ area: 2 * (1 + 3 + 3), volume: 3, borderEdges: 0 });
});

test("a slice has vertices at its uneven samples", () => {
  const { positions, samples, indices } = sliceGeometry({ size: [3, 4], origin: [5, 0, 100], right: [1, 0, 0], down: [0, 0, -4], lines: [null, [0, 0.25, 0.75, 3]] });
  const rows = [0, 1, 2, 3].map((row) => [...positions.slice(6 * row, 6 * row + 6)]);
  expect(rows).toEqual([100, 99, 97, 88].map((z) => [5, 0, z, 7, 0, z]));
  expect([...samples]).toEqual([0, 0, 2, 0, 0, 1, 2, 1, 0, 2, 2, 2, 0, 3, 2, 3]);
  expect(indices).toHaveLength(3 * 6);
  const even = sliceGeometry({ size: [3, 2], origin: [0, 0, 0], right: [1, 0, 0], down: [0, 2, 0] });
  expect([...even.positions]).toEqual([0, 0, 0, 2, 0, 0, 0, 2, 0, 2, 2, 0]);
  expect(even.indices).toEqual([0, 1, 3, 0, 3, 2]);
});
