import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { Heartbeat } from "../src/net/heartbeat";

beforeEach(() => {
  vi.useFakeTimers({ toFake: ["setInterval", "clearInterval", "performance"] });
});
afterEach(() => {
  vi.useRealTimers();
});

test("a line is dead after three promised signs that did not come, within five seconds, and said once", () => {
  const dead: number[] = [];
  const heartbeat = new Heartbeat((seconds) => dead.push(seconds));
  vi.advanceTimersByTime(60_000);
  heartbeat.heard();
  heartbeat.promised(1.5);
  for (let i = 0; i < 10; i += 1) {
    vi.advanceTimersByTime(1500);
    heartbeat.heard();
  }
  expect(dead).toEqual([]);
  vi.advanceTimersByTime(4000);
  expect(dead).toEqual([]);
  vi.advanceTimersByTime(1000);
  expect(dead).toEqual([5]);
  vi.advanceTimersByTime(60_000);
  expect(dead).toHaveLength(1);
});

test("a slow line, a server that promises nothing and a page that stood still are not dead", () => {
  const onDead = vi.fn();
  const heartbeat = new Heartbeat(onDead);
  vi.advanceTimersByTime(60_000);
  heartbeat.heard();
  heartbeat.promised(10);
  vi.advanceTimersByTime(29_000);
  expect(onDead).not.toHaveBeenCalled();
  heartbeat.heard();
  heartbeat.promised(1.5);
  // The page was busy, and the look that follows comes late: frames of that time are read first.
  vi.setSystemTime(Date.now());
  const now = vi.spyOn(performance, "now").mockReturnValue(performance.now() + 30_000);
  vi.advanceTimersByTime(500);
  expect(onDead).not.toHaveBeenCalled();
  heartbeat.heard();
  vi.advanceTimersByTime(500);
  expect(onDead).not.toHaveBeenCalled();
  now.mockRestore();
});
