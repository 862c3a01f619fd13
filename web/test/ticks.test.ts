import { describe, expect, test } from "vitest";
import { roundBelow, scaleBar, ticks, tickText } from "../src/world/ticks";

test.each([
  [1, 1],
  [9.99, 5],
  [4.9, 2],
  [20, 20],
  [0.031, 0.02],
  [700, 500],
])("the round number below %d is %d", (value, expected) => {
  expect(roundBelow(value)).toBeCloseTo(expected, 12);
});

describe("ticks", () => {
  test("are round, inside, and not too many", () => {
    expect(ticks(-12, 47, 6).map((t) => t + 0)).toEqual([-10, 0, 10, 20, 30, 40]);
    expect(ticks(0, 1, 10).map((t) => Number(t.toFixed(3)))).toEqual([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1]);
    for (const [low, high] of [[0, 1], [-1e-6, 3e-6], [1000, 1003.7], [-5e8, 2e9]] as const) {
      const found = ticks(low, high, 6);
      expect(found.length).toBeGreaterThan(1);
      expect(found.length).toBeLessThan(8);
      for (const t of found) expect(t).toBeGreaterThanOrEqual(low - 1e-9 * (high - low));
    }
  });

  test("of nothing there are none", () => {
    expect(ticks(3, 3, 5)).toEqual([]);
    expect(ticks(0, Infinity, 5)).toEqual([]);
  });

  test("have the decimals that they need", () => {
    expect(tickText(0.30000000000000004, 0.1)).toBe("0.3");
    expect(tickText(-20, 20)).toBe("−20");
    expect(tickText(-0, 5)).toBe("0");
    expect(tickText(2.5e-7, 5e-8)).toBe("2.5e-7");
  });
});

test("a scale bar has a round length and fits", () => {
  const { length, pixels } = scaleBar(0.37, 120);
  expect(length).toBe(20);
  expect(pixels).toBeCloseTo(20 / 0.37, 9);
  expect(pixels).toBeLessThanOrEqual(120);
  expect(pixels).toBeGreaterThan(120 / 2.6);
});
