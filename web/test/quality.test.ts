import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { AdaptiveQuality, FULL, REST_MS } from "../src/scene/quality";

beforeEach(() => vi.useFakeTimers());
afterEach(() => vi.useRealTimers());

/** Frames of a moving camera, each so long. */
function turn(quality: AdaptiveQuality, frames: number, ms: number) {
  let last = FULL;
  for (let i = 0; i < frames; i += 1) {
    vi.advanceTimersByTime(ms);
    last = quality.next(true);
  }
  return last;
}

test("a renderer that keeps up paints in full, also after one frame that waited", () => {
  const quality = new AdaptiveQuality(true, () => expect.unreachable());
  expect(turn(quality, 100, 16)).toEqual(FULL);
  expect(turn(quality, 2, 100)).toEqual(FULL);
  expect(turn(quality, 10, 30)).toEqual(FULL);
  // The last frame of a turn has no move, and what lies between it and the next turn is no frame.
  quality.next(false);
  vi.advanceTimersByTime(1000);
  expect(turn(quality, 1, 16)).toEqual(FULL);
  quality.next(false);
  vi.advanceTimersByTime(170);
  expect(turn(quality, 5, 16)).toEqual(FULL);
});

test("a slow one gives up effects and layers first, then pixels, until the camera rests", () => {
  const onRest = vi.fn();
  const quality = new AdaptiveQuality(true, onRest);
  turn(quality, 1, 5000);
  expect(turn(quality, 3, 100)).toEqual({ effects: false, layers: 0.5, pixels: 1 });
  expect(turn(quality, 3, 100).pixels).toBe(0.7);
  expect(turn(quality, 20, 100).pixels).toBe(0.35);
  // A frame that the surface asks for while the hand pauses is as the others.
  vi.advanceTimersByTime(REST_MS / 2);
  expect(quality.next(false).pixels).toBe(0.35);
  expect(onRest).not.toHaveBeenCalled();
  vi.advanceTimersByTime(REST_MS);
  expect(onRest).toHaveBeenCalledTimes(1);
  expect(quality.next(false)).toEqual(FULL);
  // The next turn begins with the last sufficient quality, and goes back up if frames are fast.
  expect(turn(quality, 1, 2000).pixels).toBe(0.35);
  expect(turn(quality, 45, 10).pixels).toBe(0.5);
  expect(turn(quality, 200, 10)).toEqual(FULL);
  // Two frames that are very slow are enough to give up all that helps.
  expect(turn(quality, 2, 170).pixels).toBe(0.35);
});

test("frames that take longer than the rest are slow ones, not pauses", () => {
  const quality = new AdaptiveQuality(true, () => undefined);
  turn(quality, 1, 5000);
  expect(turn(quality, 1, 1200).pixels).toBe(0.7);
  expect(turn(quality, 1, 1200).pixels).toBe(0.35);
});

test("where it is off all frames are painted in full", () => {
  expect(turn(new AdaptiveQuality(false, () => expect.unreachable()), 20, 300)).toEqual(FULL);
  vi.advanceTimersByTime(1000);
});

test("a display that limits the rate of frames gets all back by trials, which are rarer after each that fails", () => {
  const quality = new AdaptiveQuality(true, () => undefined);
  turn(quality, 4, 100);
  expect(turn(quality, 1, 20).layers).toBe(0.5);
  expect(turn(quality, 210, 20)).toEqual(FULL);
  // Full quality is too slow: back, and the next trial waits for twice as long.
  expect(turn(quality, 3, 100).layers).toBe(0.5);
  expect(turn(quality, 390, 20).layers).toBe(0.5);
  expect(turn(quality, 20, 20)).toEqual(FULL);
  // After one that held for as long, the wait is the first one again.
  turn(quality, 410, 20);
  expect(turn(quality, 3, 100).layers).toBe(0.5);
  expect(turn(quality, 210, 20)).toEqual(FULL);
  vi.advanceTimersByTime(1000);
});
