import { expect, test } from "vitest";
import { makeTurntable, MAX_FRAMES, turnedPose } from "../src/image/turntable";

const pose = { position: [3, 1, 5], target: [1, 1, 2], projection: "perspective" } as const;

test("a turn goes around the target, and ends where it began", () => {
  expect(turnedPose(pose, 0, 4)).toEqual(pose);
  const quarter = turnedPose(pose, 1, 4);
  [1, -1, 5].forEach((value, axis) => expect(quarter.position[axis]).toBeCloseTo(value, 12));
  turnedPose(pose, 4, 4).position.forEach((value, axis) => expect(value).toBeCloseTo(pose.position[axis]!, 12));
  expect(quarter.target).toEqual(pose.target);
});

test.each([0, -1, 2.5, NaN, MAX_FRAMES + 1])("%d pictures are refused", async (frames) => {
  const never = () => {
    throw new Error("not asked for");
  };
  await expect(makeTurntable(never, { frames, from: pose, parts: { ink: "#000000", scale: 1 } })).rejects.toThrow(`a turn of ${frames} pictures`);
});
