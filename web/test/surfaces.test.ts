import { describe, expect, test } from "vitest";
import { areSettled, reduceSurfaces, type SurfaceEvent, type SurfaceMaps } from "../src/regions/surfaces";

const prefix = (surface: number, generation: number, regions: number): SurfaceEvent => ({
  type: "prefix",
  surface,
  generation,
  level: 0,
  regions,
  final: true,
});
const chunk = (surface: number, generation: number, region: string, id: number): SurfaceEvent => ({
  type: "chunk",
  surface,
  generation,
  level: 0,
  region,
  id,
});
const committed = (surface: number, generation: number): SurfaceEvent => ({ type: "committed", surface, generation, level: 0 });

function run(maps: SurfaceMaps, ...events: SurfaceEvent[]) {
  const all = events.map((event) => reduceSurfaces(maps, event));
  return {
    swaps: all.flatMap(({ swaps }) => swaps).map(({ surface, show, remove }) => ({ surface, show, remove })),
    removed: all.flatMap(({ removed }) => removed),
    dropped: all.flatMap(({ dropped }) => dropped),
  };
}

describe("maps of surfaces", () => {
  test("the same region of two surfaces are two meshes", () => {
    const maps: SurfaceMaps = new Map();
    run(maps, prefix(0, 1, 1), chunk(0, 1, "a", 1), committed(0, 1));
    run(maps, prefix(3, 2, 1), chunk(3, 2, "a", 2), committed(3, 2));
    const resident = (id: number): SurfaceEvent => ({ type: "resident", id });
    expect(run(maps, resident(2)).swaps).toEqual([{ surface: 3, show: [2], remove: [] }]);
    expect(areSettled(maps)).toBe(false);
    expect(run(maps, resident(1)).swaps).toEqual([{ surface: 0, show: [1], remove: [] }]);
    expect(areSettled(maps)).toBe(true);
    run(maps, prefix(3, 3, 1), chunk(3, 3, "a", 3), committed(3, 3));
    expect(run(maps, resident(3)).swaps).toEqual([{ surface: 3, show: [3], remove: [2] }]);
  });

  test("a generation that ends forgets chunks of its own surface", () => {
    const maps: SurfaceMaps = new Map();
    run(maps, prefix(0, 1, 1), chunk(0, 1, "a", 1), committed(0, 1), prefix(1, 2, 1), chunk(1, 2, "a", 2));
    expect(run(maps, { type: "superseded", surface: 1, generation: 2 }).dropped).toEqual([2]);
    expect(run(maps, { type: "resident", id: 1 }).swaps).toHaveLength(1);
  });

  test("a removed surface goes at once, with what was on its way", () => {
    const maps: SurfaceMaps = new Map();
    run(maps, prefix(0, 1, 1), chunk(0, 1, "a", 1), committed(0, 1), { type: "resident", id: 1 });
    run(maps, prefix(1, 2, 1), chunk(1, 2, "a", 2), committed(1, 2), { type: "resident", id: 2 });
    run(maps, prefix(1, 3, 1), chunk(1, 3, "a", 3), committed(1, 3));
    expect(run(maps, { type: "removed", surface: 1 })).toEqual({ swaps: [], removed: [2], dropped: [3] });
    expect(run(maps, { type: "resident", id: 3 }).swaps).toEqual([]);
    expect(run(maps, { type: "removed", surface: 2 })).toEqual({ swaps: [], removed: [], dropped: [] });
    expect(areSettled(maps)).toBe(true);
    // If it is made again, it is a whole surface.
    run(maps, prefix(1, 4, 1), chunk(1, 4, "b", 4), committed(1, 4));
    expect(run(maps, { type: "resident", id: 4 }).swaps).toEqual([{ surface: 1, show: [4], remove: [] }]);
  });

  test("reset is of all surfaces", () => {
    const maps: SurfaceMaps = new Map();
    run(maps, prefix(0, 1, 1), chunk(0, 1, "a", 1), prefix(1, 2, 1), chunk(1, 2, "a", 2));
    expect(run(maps, { type: "reset" }).dropped).toEqual([1, 2]);
  });
});
