import { Box3, Plane, Vector3 } from "three";
import { describe, expect, test } from "vitest";
import { clipPlanes } from "../src/scene/clipping";
import { cutFaces } from "../src/scene/convex";

const box = new Box3(new Vector3(0, 0, 0), new Vector3(2, 3, 4));

function area(face: readonly Vector3[]): number {
  const sum = new Vector3();
  for (let i = 1; i + 1 < face.length; i += 1) {
    sum.add(face[i]!.clone().sub(face[0]!).cross(face[i + 1]!.clone().sub(face[0]!)));
  }
  return sum.length() / 2;
}

describe("faces of a cut box", () => {
  test("a plane across is a rectangle", () => {
    const [face] = cutFaces(box, [new Plane(new Vector3(0, 0, 1), -1)]);
    expect(face).toHaveLength(4);
    expect(face!.every((p) => p.z === 1)).toBe(true);
    expect(area(face!)).toBeCloseTo(6, 9);
  });

  test("a slanted plane through the middle of a cube is a hexagon", () => {
    const cube = new Box3(new Vector3(-1, -1, -1), new Vector3(1, 1, 1));
    const [face] = cutFaces(cube, [new Plane(new Vector3(1, 1, 1).normalize(), 0)]);
    expect(face!.length).toBeGreaterThanOrEqual(6);
    expect(area(face!)).toBeCloseTo((3 * Math.sqrt(3) / 2) * 2, 6);
  });

  test("planes cut each other's faces", () => {
    const [a, b] = cutFaces(box, [new Plane(new Vector3(1, 0, 0), -1), new Plane(new Vector3(0, 1, 0), -1)]);
    expect(area(a!)).toBeCloseTo(2 * 4, 9);
    expect(area(b!)).toBeCloseTo(1 * 4, 9);
  });

  test("a plane outside cuts nothing, one that removes all leaves nothing", () => {
    expect(cutFaces(box, [new Plane(new Vector3(0, 0, 1), 1)])).toEqual([[]]);
    expect(cutFaces(box, [new Plane(new Vector3(0, 0, 1), -9)])).toEqual([[]]);
  });

  test("a clip box has six faces, of its own size", () => {
    const planes = clipPlanes({ box: { min: [0.5, 0.5, 0.5], max: [1.5, 2.5, 3.5] }, caps: true });
    const faces = cutFaces(box, planes);
    expect(faces.map((face) => Math.round(10 * area(face)) / 10)).toEqual([6, 6, 3, 3, 2, 2]);
  });
});

test("a clip plane keeps what lies against its normal", () => {
  const [plane] = clipPlanes({ plane: { normal: [0, 0, 1], offset: 5 }, caps: true });
  expect(plane!.distanceToPoint(new Vector3(0, 0, 4))).toBeGreaterThan(0);
  expect(plane!.distanceToPoint(new Vector3(0, 0, 6))).toBeLessThan(0);
});
