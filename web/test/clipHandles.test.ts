import { Box3, Vector3 } from "three";
import { expect, test } from "vitest";
import { handlesOf } from "../src/scene/clipHandles";

const bounds = new Box3(new Vector3(0, 0, 0), new Vector3(10, 20, 30));
const box = { min: [1, 2, 3], max: [4, 5, 6] } as const;

test("a plane has one handle, on it", () => {
  const [handle, ...others] = handlesOf({ plane: { normal: [0, 0.6, 0.8], offset: 4 }, caps: true }, bounds);
  expect(others).toEqual([]);
  expect(handle!.at.dot(new Vector3(0, 0.6, 0.8))).toBeCloseTo(4, 9);
  expect(handle!.moved(7)).toEqual({ plane: { normal: [0, 0.6, 0.8], offset: 7 }, caps: true });
});

test("a box has a handle a face, and no face passes the one across", () => {
  const handles = handlesOf({ box, caps: false }, bounds);
  expect(handles.map(({ value }) => value)).toEqual([1, 4, 2, 5, 3, 6]);
  expect(handles[1]!.at.toArray()).toEqual([4, 3.5, 4.5]);
  expect(handles[1]!.moved(9).box).toEqual({ min: [1, 2, 3], max: [9, 5, 6] });
  expect(handles[1]!.moved(-9).box).toEqual({ min: [1, 2, 3], max: [1, 5, 6] });
  expect(handles[4]!.moved(99).box).toEqual({ min: [1, 2, 6], max: [4, 5, 6] });
});

test("what is not clipped has none", () => {
  expect(handlesOf({ caps: true }, bounds)).toEqual([]);
});
