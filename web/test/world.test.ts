import { Matrix4, PerspectiveCamera, Vector3 } from "three";
import { describe, expect, test } from "vitest";
import { corners, fitDistance, worldFromGrid, verticalFov, worldFromIndex, type Grid } from "../src/scene/world";

const grid: Grid = {
  origin: [10, -20, 30],
  spacing: [0.5, 2, 3],
  // Turned a quarter about z, and mirrored in z.
  direction: [[0, 1, 0], [-1, 0, 0], [0, 0, -1]],
};

test("index space lies where origin, spacing and direction say", () => {
  const at = (i: number, j: number, k: number) => new Vector3(i, j, k).applyMatrix4(worldFromIndex(grid)).toArray();
  expect(at(0, 0, 0)).toEqual([10, -20, 30]);
  expect(at(4, 0, 0)).toEqual([10, -18, 30]);
  expect(at(0, 1, 0)).toEqual([8, -20, 30]);
  expect(at(0, 0, 2)).toEqual([10, -20, 24]);
  expect(worldFromIndex(grid).determinant()).toBeLessThan(0);
});

test("normals turn with the direction and keep their length", () => {
  const normal = new Vector3(0.6, 0, 0.8).applyMatrix3(worldFromGrid(grid));
  expect(normal.toArray()).toEqual([0, 0.6, -0.8]);
});

describe("fit", () => {
  const points = [
    ...corners({ min: [-1, -8, 2], max: [5, 4, 3] }, new Matrix4()),
    ...corners({ min: [0, 0, 0], max: [1, 1, 1] }, new Matrix4().makeTranslation(4, 4, 5)),
  ];
  const center = new Vector3(2, -2, 3);
  const up = new Vector3(0, 0, 1);

  test.each([
    [new Vector3(1, 0, 0), 1.6],
    [new Vector3(-0.7, 0.6, 0.4), 1],
    [new Vector3(0.1, -0.2, 0.97), 0.4],
  ])("sees all points, and not from further than needed (from %o, aspect %d)", (direction, aspect) => {
    const back = direction.clone().normalize();
    const fov = 32;
    const distance = fitDistance(points, center, back, up, (fov * Math.PI) / 180, aspect);
    const camera = new PerspectiveCamera(fov, aspect, 0.01, 1000);
    camera.up.copy(up);
    camera.position.copy(center).addScaledVector(back, distance);
    camera.lookAt(center);
    camera.updateMatrixWorld();
    let reach = 0;
    for (const point of points) {
      const p = point.clone().applyMatrix4(camera.matrixWorldInverse).applyMatrix4(camera.projectionMatrix);
      reach = Math.max(reach, Math.abs(p.x), Math.abs(p.y));
    }
    expect(reach).toBeCloseTo(1, 6);
  });
});

test("the smaller field of view is the same in all windows", () => {
  const fov = 0.56;
  const across = (aspect: number) => 2 * Math.atan(Math.tan(verticalFov(fov, aspect) / 2) * aspect);
  expect([verticalFov(fov, 1), verticalFov(fov, 2.5)].map((n) => n.toFixed(6))).toEqual(["0.560000", "0.560000"]);
  expect([across(0.9), across(0.4)].map((n) => n.toFixed(6))).toEqual(["0.560000", "0.560000"]);
});
