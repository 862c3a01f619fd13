import { describe, expect, test } from "vitest";
import { decodeLink } from "../src/state/link";
import { physicalAxes, type DescribedAxis } from "../src/world/physicalAxes";

/** As the server counts samples of an ocean: depth goes down. */
const GRID = { dims: [180, 90, 5], spacing: [1, 1, 1], origin: [0, 0, 0], direction: [[1, 0, 0], [0, 1, 0], [0, 0, -1]] } as const;
const axis = (kind: string, unit: string | null, positions: readonly number[] | null, pointsDown = false): DescribedAxis => ({ name: kind, unit, kind, positions, pointsDown });
const LONGITUDES = Array.from({ length: 180 }, (_, i) => 20.5 + 2 * i);
const DEPTHS = [0, 10, 100, 500, 1000];
const ocean = () => physicalAxes(GRID, [axis("longitude", "degrees_east", LONGITUDES), null, axis("depth", "METERS", DEPTHS, true)]);

describe("physical axes", () => {
  test("have round ticks where samples are counted, at uneven positions too", () => {
    const [longitude, latitude, depth] = ocean();
    expect(latitude).toBeUndefined();
    expect(longitude?.title).toBe("Longitude");
    expect(longitude?.ticks(0, 179, 6).map(({ text }) => text)).toEqual(["60° E", "120° E", "180°", "120° W", "60° W", "0°"]);
    expect(longitude?.ticks(0, 179, 6)[0]?.at).toBeCloseTo((60 - 20.5) / 2);
    expect(depth?.title).toBe("Depth (m)");
    const ticks = depth?.ticks(-4, 0, 6) ?? [];
    expect(ticks.map(({ text }) => text)).toEqual(["0", "200", "400", "600", "800", "1000"]);
    expect(ticks.map(({ at }) => Number(at.toFixed(3)))).toEqual([0, -2.25, -2.75, -3.2, -3.6, -4]);
  });

  test("are the world's coordinates where these are positions, and downwards their negatives", () => {
    const grid = { ...GRID, origin: [-30, 0, 0] as const };
    const [x, y, z] = physicalAxes(grid, [axis("longitude", "degrees_east", null), axis("latitude", "degrees_north", null), axis("depth", "km", null, true)]);
    expect(x?.ticks(-30, 149, 6).map(({ at, text }) => [at, text])).toEqual([[-30, "30° W"], [0, "0°"], [30, "30° E"], [60, "60° E"], [90, "90° E"], [120, "120° E"]]);
    expect(y?.ticks(0, 89, 4).map(({ text }) => text)).toEqual(["0°", "30° N", "60° N"]);
    expect(z?.ticks(-4, 0, 4).map(({ at, text }) => [at, text])).toEqual([[0, "0"], [-1, "1"], [-2, "2"], [-3, "3"], [-4, "4"]]);
  });

  test("say the position at a place, and nothing outside", () => {
    const [longitude, , depth] = ocean();
    expect(longitude?.textAt(0)).toBe("20.5° E");
    expect(depth?.textAt(-2.5)).toBe("300");
    expect(depth?.textAt(-9)).toBeUndefined();
  });

  test("are those along the world's axes alone", () => {
    const turned = { ...GRID, direction: [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]] as const };
    const found = physicalAxes(turned, [axis("longitude", null, LONGITUDES), axis("latitude", null, LONGITUDES), axis("height", "m", DEPTHS)]);
    expect(found.map((one) => one?.title)).toEqual([undefined, undefined, "Height (m)"]);
    expect(physicalAxes(GRID, undefined)).toEqual([undefined, undefined, undefined]);
  });
});

test("a link has the vertical exaggeration, within bounds", () => {
  expect(decodeLink("volume=a&heights=5")?.look.exaggeration).toBe(5);
  for (const bad of ["0", "-1", "1e9", "x"]) expect(() => decodeLink(`volume=a&heights=${bad}`)).toThrow("heights");
});
