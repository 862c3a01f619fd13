import { describe, expect, test } from "vitest";
import type { View } from "../src/protocol/types";
import { linesOf, Outlines, type Outlined } from "../src/scene/outlines";
import { Outlining } from "../src/wiring/marks";

const points = (numbers: readonly number[]) => Array.from({ length: numbers.length / 3 }, (_, i) => numbers.slice(3 * i, 3 * i + 3));

describe("the outline of a region", () => {
  test("of a sphere are three closed circles on it", () => {
    const all = points(linesOf({ center: [1, 2, 3], radius: 5 }));
    expect(all).toHaveLength(3 * 128);
    for (const [x, y, z] of all) expect(Math.hypot(x! - 1, y! - 2, z! - 3)).toBeCloseTo(5, 9);
    for (const circle of [0, 1, 2]) {
      const ends = all.slice(128 * circle, 128 * (circle + 1));
      // Each segment begins where the one before it ends, and the last one ends where the first begins.
      for (let i = 1; i < 128; i += 2) ends[i]!.forEach((n, axis) => expect(n).toBeCloseTo(ends[(i + 1) % 128]![axis]!, 9));
      expect(new Set(ends.map((end) => end[circle]))).toEqual(new Set([circle + 1]));
    }
  });

  test("of a box are its twelve edges", () => {
    const all = points(linesOf({ min: [0, 0, 0], max: [1, 2, 4] }));
    const lengths = all.filter((_, i) => i % 2 === 0).map((from, i) => Math.hypot(...from.map((n, axis) => n - all[2 * i + 1]![axis]!)));
    expect(lengths.sort()).toEqual([1, 1, 1, 1, 2, 2, 2, 2, 4, 4, 4, 4]);
  });

  test("is drawn twice: where it is seen, and fainter where it is hidden; the one that is pointed at apart", () => {
    const outlines = new Outlines();
    const ball: Outlined = { center: [0, 0, 0], radius: 1 };
    outlines.set([ball, ball], undefined);
    expect(outlines.object.children).toHaveLength(2);
    outlines.set([ball, ball], 1);
    expect(outlines.object.children).toHaveLength(4);
    outlines.set([], undefined);
    expect(outlines.object.children).toHaveLength(0);
  });
});

test("regions are outlined while the page is about them; what is as before costs no frame", () => {
  const shown: [number, number | undefined][] = [];
  const outlining = new Outlining({ annotations: { outline: (regions: readonly unknown[], strong?: number) => shown.push([regions.length, strong]) } } as unknown as ConstructorParameters<typeof Outlining>[0]);
  const interest: View["interest"] = [{ sphere: { center: [0, 0, 0], radius: 1 }, importance: 0.9 }, { box: { min: [0, 0, 0], max: [1, 1, 1] }, importance: 1 }];
  const page = { inspector: true, outlined: "all" } as const;
  outlining.show([], page);
  outlining.show(interest, { ...page, outlined: undefined });
  expect(shown).toEqual([]);
  outlining.show(interest, page);
  outlining.show(interest, page);
  outlining.show(interest, { ...page, outlined: 1 });
  outlining.show(interest, { ...page, inspector: false });
  expect(shown).toEqual([[2, undefined], [2, 1], [0, undefined]]);
});
