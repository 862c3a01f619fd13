import { expect, test } from "vitest";
import { fitInto, indicesAtPixel, pixelOf, sliceViews } from "../src/slices/view";
import { keptInSight, panned, zoomedAt, zoomedFit } from "../src/slices/zoom";

const GRID = { dims: [100, 80, 60], spacing: [1, 2, 1], origin: [0, 0, 0], direction: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] } as const;
const view = sliceViews(GRID, false)[0]!;
const SIZE = [300, 200] as const;
const whole = fitInto(view, ...SIZE, 10);

test("what is at a place stays there, however much is zoomed", () => {
  const place = [220, 50] as const;
  const under = indicesAtPixel(view, whole, ...place);
  let zoom = zoomedAt(whole, SIZE, undefined, place, 2);
  zoom = zoomedAt(whole, SIZE, zoom, place, 3);
  expect(zoom?.factor).toBeCloseTo(6);
  const fit = zoomedFit(whole, SIZE, zoom);
  indicesAtPixel(view, fit, ...place).forEach((index, i) => expect(index).toBeCloseTo(under[i]!));
  const [[ax], [bx]] = [pixelOf(view, fit, 10, 10), pixelOf(view, fit, 11, 10)];
  expect(bx - ax).toBeCloseTo(6 * whole.scale);
});

test("the whole slice is the smallest, and there is a largest", () => {
  const zoom = zoomedAt(whole, SIZE, undefined, [10, 10], 1e9);
  expect(zoom?.factor).toBe(40);
  expect(zoomedAt(whole, SIZE, zoom, [10, 10], 0.001)).toBeUndefined();
  expect(zoomedAt(whole, SIZE, zoom, [10, 10], 0)).toBeUndefined();
  expect(zoomedAt(whole, SIZE, undefined, [10, 10], 0.8)).toBeUndefined();
  expect(zoomedFit(whole, SIZE, undefined)).toBe(whole);
});

test("it is moved by pixels, and follows the crosshair that leaves it", () => {
  const zoom = zoomedAt(whole, SIZE, undefined, [150, 100], 4)!;
  const before = pixelOf(view, zoomedFit(whole, SIZE, zoom), 50, 40);
  const after = pixelOf(view, zoomedFit(whole, SIZE, panned(whole, zoom, [7, -3])), 50, 40);
  expect([after[0] - before[0], after[1] - before[1]].map((n) => Number(n.toFixed(6)))).toEqual([7, -3]);
  expect(panned(whole, undefined, [7, 3])).toBeUndefined();
  const [i, j] = indicesAtPixel(view, zoomedFit(whole, SIZE, zoom), 160, 90);
  expect(keptInSight(view, whole, SIZE, zoom, i, j)).toBe(zoom);
  const moved = keptInSight(view, whole, SIZE, zoom, 0, 0);
  pixelOf(view, zoomedFit(whole, SIZE, moved), 0, 0).forEach((n, axis) => expect(n).toBeCloseTo(SIZE[axis]! / 2));
});
