import { expect, test } from "vitest";
import { AXIS_VIEWS, isPose } from "../src/scene/pose";

const pose = { position: [1, 2, 3], target: [0, 0, 0], projection: "orthographic" };

test("a pose survives JSON", () => {
  expect(isPose(JSON.parse(JSON.stringify(pose)))).toBe(true);
});

test.each([
  undefined,
  "here",
  { ...pose, position: [1, 2] },
  { ...pose, position: [1, 2, Infinity] },
  { ...pose, target: [0, "0", 0] },
  { ...pose, position: [0, 0, 0] },
  { ...pose, projection: "fisheye" },
])("%j is none", (value) => {
  expect(isPose(value)).toBe(false);
});

test("views along the axes look from unit vectors", () => {
  for (const direction of Object.values(AXIS_VIEWS)) expect(Math.hypot(...direction)).toBeCloseTo(1, 9);
});
