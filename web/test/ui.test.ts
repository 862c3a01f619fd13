import { describe, expect, test } from "vitest";
import { formatBytes, formatCount, formatError, formatMs, formatPercent, formatValue, parseValue } from "../src/ui/format";
import { histogramPath } from "../src/ui/panel/histogram";
import { criterion, gaveWayText, inSpacings, trianglesOf } from "../src/ui/panel/criterion";
import { BETA_SCALE, ERROR_SCALE } from "../src/ui/panel/decimationSection";
import { derivedFeature, featureInfo } from "../src/ui/panel/features";
import { interestText } from "../src/ui/panel/importanceSection";
import { openingText } from "../src/ui/panel/surfaceSection";
import { complete } from "../src/state/view";
import type { Edit, View } from "../src/protocol/types";
import { OPENING, statistics, VOLUMES } from "./fixture";

describe("numbers", () => {
  test("unfinished text is no number", () => {
    for (const text of ["", "-", "+", "1e", "1e-", ".", "1.2.3", "0x10", "12 cm", "Infinity", "NaN", "1,2,3"]) {
      expect(parseValue(text), text).toBeUndefined();
    }
  });

  test("numbers are parsed", () => {
    expect(parseValue(" 517 ")).toBe(517);
    expect(parseValue("-2e3")).toBe(-2000);
    expect(parseValue("1,5")).toBe(1.5);
    expect(parseValue(".5")).toBe(0.5);
    expect(parseValue("−3")).toBe(-3);
  });

  test("are formatted", () => {
    expect(formatCount(1234567)).toBe("1,234,567");
    expect([0, 999, 1000, 252082, 9_960_000, 1.5e9].map(formatBytes)).toEqual(["0 B", "999 B", "1.0 kB", "252 kB", "10 MB", "1.5 GB"]);
    expect([12.4, 999.4, 2310].map(formatMs)).toEqual(["12 ms", "999 ms", "2.31 s"]);
    expect([0.30000001, 1234567, 1234567.5, -33.0171, NaN].map((v) => formatValue(v))).toEqual(["0.3", "1234567", "1234600", "-33.017", ""]);
  });
});

describe("β", () => {
  test("has the full surface at the low end and 1 at the high end", () => {
    expect(BETA_SCALE.toValue(0)).toBe(-1);
    expect(BETA_SCALE.toValue(1)).toBe(1);
    expect(BETA_SCALE.toPosition(-1)).toBe(0);
    expect(BETA_SCALE.toPosition(-0.5)).toBe(0);
    expect(BETA_SCALE.toPosition(0)).toBeGreaterThan(0);
  });

  test("maps to the slider and back", () => {
    for (const position of [0.25, 0.5, 0.9, 1]) expect(BETA_SCALE.toPosition(BETA_SCALE.toValue(position))).toBeCloseTo(position, 3);
  });
});

describe("histograms", () => {
  test("of one value, or none, have no curve", () => {
    expect(histogramPath({ min: 3, max: 3, counts: [9] }, 3, 3, 100, 10)).toBe("");
    expect(histogramPath({ min: 0, max: 1, counts: [0, 0] }, 0, 1, 100, 10)).toBe("");
  });

  test("peak where the counts do", () => {
    const counts = new Array<number>(256).fill(0);
    counts[64] = 100;
    const ys = [...histogramPath({ min: 0, max: 1, counts }, 0, 1, 100, 100).matchAll(/L([\d.]+) ([\d.]+)/g)].map((m) => [Number(m[1]), Number(m[2])] as const);
    const top = ys.reduce((a, b) => (b[1] < a[1] ? b : a));
    expect(top[0]).toBeCloseTo(25, -0.5);
    expect(top[1]).toBeCloseTo(6, 0);
  });
});

test("regions of interest are counted", () => {
  expect([1, 2, 64].map(interestText)).toEqual(["1 region of interest", "2 regions of interest", "64 regions of interest"]);
});

test("a share is full only where nothing is missing", () => {
  expect([0, 0.999, 1].map(formatPercent)).toEqual(["0 %", "99 %", "100 %"]);
});

test("an error is measured, estimated with its sign, or nothing", () => {
  const both = { error: { rms: 0.0412, max: 0.31 }, estimatedError: { rms: 0.0523 } };
  expect(formatError(both, 2)).toBe("0.041 / 0.31");
  expect(formatError({ ...both, error: null }, 2)).toBe("≈ 0.052");
  expect(formatError({ error: null, estimatedError: null }, 2)).toBeUndefined();
  expect(formatError(undefined, 2)).toBeUndefined();
});

test("why a field opens with its isovalue is said as long as that is in force", () => {
  const depth = VOLUMES[0]!.fields[0]!;
  const { openingIso } = depth;
  expect(openingText(depth, openingIso!.iso)).toBe("Opens here: between two classes of values");
  expect(openingText(depth, openingIso!.iso + 1)).toBe("");
  expect(openingText(undefined, 0)).toBe("");
});

test("the derived feature is that of the field whose surface is shown", () => {
  const volume = VOLUMES[0]!;
  const [depth, height] = volume.fields;
  expect(featureInfo(volume, { feature: "gradient-magnitude", field: "depth" })).toBe(depth?.derivedFeatures["gradient-magnitude"]);
  expect(featureInfo(volume, { feature: "gradient-magnitude", field: "height" })).toBe(height?.derivedFeatures["gradient-magnitude"]);
  expect(derivedFeature(volume, { feature: "gradient-magnitude", field: "depth" })).toBe(depth?.derivedFeatures["gradient-magnitude"]);
  expect(depth?.derivedFeatures["gradient-magnitude"]?.range).not.toEqual(height?.derivedFeatures["gradient-magnitude"]?.range);
  expect(derivedFeature(volume, { feature: "height", field: "depth" })).toBeUndefined();
  expect(derivedFeature(volume, { feature: "constructor", field: "depth" })).toBeUndefined();
  expect(featureInfo(volume, { feature: "height", field: "depth" })).toBe(height);
  expect(featureInfo(volume, { feature: "none", field: "depth" })).toBeUndefined();
});

describe("an edit", () => {
  test("clears what decided before, and nothing else", () => {
    const none = { beta: undefined, error: undefined, triangles: undefined, bytes: undefined };
    expect(complete({ beta: 0.1 })).toEqual({ ...none, beta: 0.1 });
    expect(complete({ triangles: 500, topology: "free" })).toEqual({ ...none, triangles: 500, topology: "free" });
    expect(complete({ error: "0.1vx", triangles: { share: 0.5 } })).toEqual({ ...none, error: "0.1vx", triangles: { share: 0.5 } });
    expect(Object.keys(complete({ error: 0 }))).toEqual(["error", "beta", "triangles", "bytes"]);
    expect(complete({ iso: 3 })).toEqual({ iso: 3 });
  });
});

describe("what decides", () => {
  const view = (edit: Edit): View => ({ ...OPENING, ...complete(edit) });
  const found = (tolerance: number | null) => ({ ...statistics(100), tolerance });

  test("is what the view names", () => {
    expect(criterion(view({ beta: 0.1 }), undefined, 1)).toBe("beta");
    expect(criterion(view({ triangles: 9 }), found(3), 1)).toBe("triangles");
    expect(criterion(view({ bytes: 9 }), undefined, 1)).toBe("triangles");
    expect(criterion(view({ error: 2 }), found(2), 1)).toBe("error");
  });

  test("is the greater of an error and a budget", () => {
    const both = view({ error: "0.1vx", triangles: 9 });
    expect(criterion(both, undefined, 2)).toBe("error");
    expect(criterion(both, found(Math.fround(0.2)), 2)).toBe("error");
    expect(criterion(both, found(0.3), 2)).toBe("triangles");
    expect(criterion(both, found(null), 2)).toBe("error");
  });

  test("is shown as multiples of the spacing, and as a number of triangles", () => {
    expect([inSpacings("0.25vx", 0.5), inSpacings(0.25, 0.5), inSpacings("0.25", 0.5)]).toEqual([0.25, 0.5, 0.5]);
    const share = { share: 0.25, max: 1000 };
    expect([100, 401, 1_000_000, 1].map((full) => trianglesOf(share, full))).toEqual([25, 100, 1000, 1]);
    expect([trianglesOf(share, undefined), trianglesOf({ share: 0.5 }, undefined), trianglesOf(7, 1)]).toEqual([1000, undefined, 7]);
  });

  test("has its slider", () => {
    for (const position of [0, 0.25, 0.5, 1]) expect(ERROR_SCALE.toPosition(ERROR_SCALE.toValue(position))).toBeCloseTo(position, 2);
    expect([0, 1].map(ERROR_SCALE.toValue)).toEqual([0.01, 4]);
    expect([0, 100].map(ERROR_SCALE.toPosition)).toEqual([0, 1]);
  });

  test("is said in words where a guard gave way", () => {
    expect(gaveWayText("max-error", found(0.64), 2)).toBe("Error of 0.32 × spacing: the budget is too small for less");
    expect(gaveWayText("topology", found(1), 2)).toBe("Topology not kept: the budget is too small");
  });
});
