import { describe, expect, test } from "vitest";
import type { FieldInfo, VolumeInfo } from "../src/protocol/types";
import { affineOf, fieldRows, frameText, missingText, volumeRows } from "../src/ui/cards/dataWords";
import { binAt, countTicks, heightOf, shortCount, stepPath } from "../src/ui/plots/axis";
import { VOLUMES } from "./fixture";

const GEOMETRY: VolumeInfo["geometry"] = {
  dims: [10, 20, 30],
  spacing: [1, 2, 0.5],
  origin: [-5, 1e-17, 3.25],
  direction: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
  frame: "LPS",
  unit: "mm",
};
const FIELD: FieldInfo = { name: "T1", type: "u16", storedType: "float64", unit: null, range: [0, 1000], histogram: { min: 0, max: 1000, counts: [5000, 400, 0, 100] }, derivedFeatures: {} };

describe("what is known of the data, in words", () => {
  test("of the volume: samples, spacing, size, origin, axes", () => {
    const rows = new Map(volumeRows({ ...VOLUMES[0]!, id: "head", title: "Head", geometry: GEOMETRY }, "12.5 s, 2 of 3"));
    expect(Object.fromEntries(rows)).toEqual({
      Volume: "Head",
      "Name in links": "head",
      "Time step": "12.5 s, 2 of 3",
      Samples: "10 × 20 × 30 (6,000)",
      Spacing: "1 × 2 × 0.5 mm",
      Size: "9 × 38 × 14.5 mm",
      Origin: "-5, 0, 3.25 mm",
      Axes: "LPS: x to the left, y to the back (posterior), z to the head (superior)",
    });
    const uneven = { ...GEOMETRY, positions: [null, [0, 1, 4], null] as VolumeInfo["geometry"]["positions"] & object };
    expect(new Map(volumeRows({ ...VOLUMES[0]!, geometry: uneven }, undefined)).get("Spacing")).toBe("1 × 1…3 × 0.5 mm");
    expect([frameText("world"), frameText("index"), frameText("RAS")]).toEqual(["not stated by the file", "coordinates are sample indices", "RAS: x to the right, y to the front (anterior), z to the head (superior)"]);
  });

  test("the matrix has axes times spacing in its columns, and the origin", () => {
    expect(affineOf(GEOMETRY)).toEqual([
      ["0", "-2", "0", "-5"],
      ["1", "0", "0", "0"],
      ["0", "0", "0.5", "3.25"],
    ]);
  });

  test("of a field: types, unit, range, missing values, memory", () => {
    expect(Object.fromEntries(fieldRows(FIELD, GEOMETRY))).toEqual({
      Type: "u16, float64 in the file",
      Unit: "not stated",
      Range: "0 to 1000",
      "Missing values": "8.3 % of the samples (500)",
      "On the device": "12 kB",
    });
    expect(missingText({ histogram: { min: 0, max: 1, counts: [6000] } }, GEOMETRY)).toBe("none");
    // Its histogram is of some planes.
    expect(missingText(FIELD, { dims: [1024, 1024, 1024] })).toBeUndefined();
  });
});

describe("the histogram's axes", () => {
  test("counts are in proportion, or logarithmic from 0 on", () => {
    expect([heightOf(0, 1000, "log"), heightOf(1000, 1000, "log"), heightOf(250, 1000, "linear"), heightOf(5, 0, "linear")]).toEqual([0, 1, 0.25, 0]);
    expect(heightOf(9, 99, "log")).toBeCloseTo(0.5);
    expect(stepPath({ counts: [4, 0, 2] }, "linear", 30, 10)).toBe("M0 10L0.0 0.0L10.0 0.0L10.0 10.0L20.0 10.0L20.0 5.0L30.0 5.0L30 10Z");
  });

  test("lines across the plot are at round counts, few of them", () => {
    expect(countTicks(1000, "linear")).toEqual([500, 1000]);
    expect(countTicks(7300, "linear")).toEqual([2000, 4000, 6000]);
    expect(countTicks(7300, "log")).toEqual([10, 100, 1000]);
    expect(countTicks(3e9, "log").length).toBeLessThanOrEqual(4);
    expect([countTicks(0, "log"), countTicks(1, "log")]).toEqual([[], []]);
    expect([7, 1500, 250_000, 3.2e6, 1e9].map(shortCount)).toEqual(["7", "1.5 k", "250 k", "3.2 M", "1 G"]);
  });

  test("a bin has its values and samples", () => {
    const { histogram } = FIELD;
    expect([binAt(histogram, 0.3), binAt(histogram, 1), binAt(histogram, -1).count]).toEqual([{ low: 250, high: 500, count: 400 }, { low: 750, high: 1000, count: 100 }, 5000]);
  });
});
