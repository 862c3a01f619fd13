import { expect, test } from "vitest";
import { axisView, homeDirection, isPose, upAlong } from "../src/scene/pose";
import { sidesOf, type AxisName } from "../src/world/axes";

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

const AXES: readonly AxisName[] = ["+x", "-x", "+y", "-y", "+z", "-z"];
const FRAMES = ["LPS", "RAS", "world", undefined];

/** Upwards in the picture, from a direction to the camera: the third axis of the world, as far as it is across the view. */
function upwards([x, y, z]: readonly number[]): readonly number[] {
  const across = [-(z ?? 0) * (x ?? 0), -(z ?? 0) * (y ?? 0), 1 - (z ?? 0) ** 2];
  const length = Math.hypot(...across);
  return across.map((c) => Math.round(c / length) + 0);
}

test.each(FRAMES)("views along the axes of %s look from unit vectors, and are up where faces of the cube say", (frame) => {
  for (const axis of AXES) {
    const direction = axisView(axis, frame);
    expect(Math.hypot(...direction)).toBeCloseTo(1, 9);
    if (axis === "+z" || axis === "-z") expect(upwards(direction)).toEqual(upAlong(axis, frame).map((c) => c + 0));
  }
});

test.each(["LPS", "RAS"])("of a patient in %s the front is up from head and feet, and home is before it, to its left", (frame) => {
  const sides = sidesOf(frame);
  const towards = (letter: string) => axisView(AXES.find((axis) => sides[axis]?.letter === letter) ?? "+x", frame);
  const along = (a: readonly number[], b: readonly number[]) => a.reduce((sum, c, i) => sum + c * (b[i] ?? 0), 0);
  for (const axis of ["+z", "-z"] as const) expect(along(upAlong(axis, frame), towards("A"))).toBe(1);
  const home = homeDirection(frame);
  for (const letter of ["A", "L", "S"]) expect(along(home, towards(letter))).toBeGreaterThan(0.3);
});
