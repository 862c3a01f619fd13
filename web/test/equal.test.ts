import { expect, test } from "vitest";
import { isEqual } from "../src/protocol/equal";

test("values are equal that say the same in a message", () => {
  const view = { iso: 1, parts: { hide: [[1, 2, 3]] }, mask: null };
  expect(isEqual(view, structuredClone(view))).toBe(true);
  expect(isEqual({ ...view, beta: undefined }, view)).toBe(true);
  expect([isEqual(undefined, undefined), isEqual(0, -0), isEqual([], [])]).toEqual([true, true, true]);
});

test("values differ in a number, a length, a kind or a field", () => {
  const pairs: readonly (readonly [unknown, unknown])[] = [[1, 2], [1, "1"], [null, undefined], [null, {}], [[1], [1, 2]], [[], {}], [{ a: 1 }, { a: 1, b: null }], [{ a: [{ b: 1 }] }, { a: [{ b: 2 }] }]];
  for (const [a, b] of pairs) expect([isEqual(a, b), isEqual(b, a)], JSON.stringify([a, b])).toEqual([false, false]);
});
