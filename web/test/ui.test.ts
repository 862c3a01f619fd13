import { describe, expect, test } from "vitest";
import { digitsBetween, formatBytes, formatCount, formatMs, formatPercent, formatShare, formatValue } from "../src/ui/format";
import { histogramPath } from "../src/ui/plots/histogram";
import { criterion, gaveWayText, inSpacings, trianglesOf } from "../src/ui/cards/criterion";
import { BETA_SCALE, ERROR_SCALE } from "../src/ui/cards/scales";
import { derivedFeature, ownRange } from "../src/state/fields";
import { bestOther, featureInfo, label, otherFeatures } from "../src/ui/cards/features";
import { limitsOf } from "../src/ui/cards/limits";
import { alphaText, coarseText, onSurface } from "../src/ui/cards/matters";
import { interestText, regionText } from "../src/ui/cards/paintTools";
import { budgetOf, SHARE_SCALE, SHARE_TICKS, shareOf, trianglesShown } from "../src/ui/cards/share";
import { nextLevel } from "../src/ui/cards/peel";
import { openingText } from "../src/ui/cards/surface";
import { landmarks } from "../src/ui/plots/landmarks";
import { refusedText } from "../src/ui/widgets/numberField";
import { valueAfter } from "../src/ui/widgets/slider";
import { countWords, errorWords, formatSeconds, hintText, summaryOf } from "../src/ui/words";
import { readTyped } from "../src/state/typedNumber";
import { complete, difference } from "../src/protocol/view";
import { knownOfOne, NOTHING_KNOWN } from "./acting";
import type { Edit, View } from "../src/protocol/types";
import { OPENING, statistics, VOLUMES, voxels } from "./fixture";

describe("numbers", () => {
  test("what is not taken of a text is said, with what is taken in its place", () => {
    const percent = { label: "Opacity", min: 5, max: 100, hundredPercent: 100 };
    expect(refusedText("1e", percent, 40)).toBe("“1e” is not a number: Opacity stays 40");
    expect(refusedText("1e9", percent, 100)).toBe("Opacity: the maximum is 100");
    expect(refusedText("-3", percent, 5)).toBe("Opacity: the minimum is 5");
    expect([refusedText("40", percent, 40), refusedText(" ", percent, 40), refusedText("40 %", percent, 40), refusedText("1e30", { label: "Isovalue" }, 1e30)]).toEqual([undefined, undefined, undefined, undefined]);
  });

  test("are formatted", () => {
    expect(formatCount(1234567)).toBe("1,234,567");
    expect([0, 999, 1000, 252082, 9_960_000, 1.5e9].map(formatBytes)).toEqual(["0 B", "999 B", "1.0 kB", "252 kB", "10 MB", "1.5 GB"]);
    expect([12.4, 999.4, 2310].map(formatMs)).toEqual(["12 ms", "999 ms", "2.31 s"]);
    expect([0.30000001, 1234567, 1234567.5, -33.0171, NaN].map((v) => formatValue(v))).toEqual(["0.3", "1234567", "1234600", "-33.017", ""]);
    // No rows of zeros, which would have to be counted, and of which a field has no place for the last.
    expect([3.0142966e-10, 0.0000391234, 0.0001, 0.043271, 1000000300000, -2.5e11].map((v) => formatValue(v))).toEqual(["3.0143e-10", "3.9123e-5", "0.0001", "0.043271", "1e12", "-2.5e11"]);
    expect(readTyped(formatValue(-2.5e11))).toBe(-2.5e11);
  });

  test("have as many digits as tell values of a range apart", () => {
    expect([digitsBetween(0, 255), digitsBetween(-1, 1), digitsBetween(7, 7), digitsBetween(0, 0)]).toEqual([4, 4, 4, 4]);
    const [low, high] = [101324.18, 101443.44];
    expect([low, high].map((v) => formatValue(v, digitsBetween(low, high)))).toEqual(["101324", "101443"]);
    const offset = [1e12, 1e12 + 1e6].map((v) => formatValue(v, digitsBetween(1e12, 1e12 + 1e6)));
    expect(offset).toEqual(["1e12", "1.000001e12"]);
  });
});

test("triangles are counted against one number, and never more than all", () => {
  expect(countWords(87_501, 454_932)).toBe("87,501 of 454,932 triangles (19 %)");
  expect([countWords(664_308, 662_406), countWords(5, 0)]).toEqual(["664,308 triangles (all)", "5 triangles"]);
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

  test("have parts, in each column as high as their share", () => {
    const heights = (part: readonly number[]) =>
      [...histogramPath({ min: 0, max: 1, counts: [100, 100] }, 0, 1, 104, 100, { min: 0, max: 1, counts: part }).matchAll(/L[\d.]+ ([\d.]+)/g)].map((m) => 100 - Number(m[1]));
    const [left, right] = [heights([50, 100])[10], heights([50, 100])[90]];
    expect([left, right]).toEqual([47, 94]);
    expect(heights([0, 0])[10]).toBe(0);
  });
});

test("the editor has the values of this surface, and says what becomes coarse", () => {
  const of = { type: "distribution", surface: 0, generation: 1, kind: "tree", bins: [3, 1], coarse: [2, 0], coarseShare: 0.5 } as const;
  expect(onSurface(of)).toEqual({ histogram: { min: 0, max: 1, counts: [3, 1] }, range: [0, 1], coarse: { min: 0, max: 1, counts: [2, 0] } });
  expect(onSurface(undefined)).toBeUndefined();
  expect([0.5, 0, undefined].map(coarseText)).toEqual(["50 % of the surface is simplified (hatched)", "Nothing of this surface is simplified", ""]);
});

test("regions of interest are counted", () => {
  expect([1, 2, 64].map(interestText)).toEqual(["1 region of interest", "2 regions of interest", "64 regions of interest"]);
  const importance = 0.95;
  expect(regionText({ sphere: { center: [1.2345, -2, 30], radius: 5.5 }, importance })).toBe("Radius 5.5 at 1.23, -2, 30");
  expect(regionText({ sphere: { center: [1, 2, 3], radius: 5.5 }, importance }, "mm")).toBe("Radius 5.5 mm at 1, 2, 3");
  expect(regionText({ box: { min: [0, 0, 0], max: [1, 2, 3] }, importance })).toBe("Box from 0, 0, 0 to 1, 2, 3");
});

test("a share is full only where nothing is missing", () => {
  expect([0, 0.999, 1].map(formatPercent)).toEqual(["0 %", "99 %", "100 %"]);
});

test("a share is in two digits, and 100 % only of all", () => {
  expect([1, 0.9999, 0.19234, 0.0243, 0.00081].map(formatShare)).toEqual(["100 %", "99 %", "19 %", "2.4 %", "0.081 %"]);
});

describe("the top line", () => {
  const shown = { generation: 1, level: 0, final: true };
  const known = { ...statistics(100), fullTriangles: 400 };
  const final = { ...knownOfOne({ shown, statistics: known }), connection: "connected" as const };

  test("says the surface in words", () => {
    const { parts, activity } = summaryOf(final, 100, false, voxels(0.5));
    expect(parts).toEqual(["100 of 400 triangles (25 %)", "error ≈ 0.1 voxels (RMS)"]);
    expect(activity).toBe("");
  });

  test("counts the full surface of the mesher in use", () => {
    const all = knownOfOne({ shown, statistics: { ...known, triangles: 404, mesherTriangles: 404 } });
    expect(summaryOf(all, 404, false, voxels(0.5)).parts[0]).toBe("404 triangles (all)");
    expect(summaryOf(all, 402, false, voxels(0.5)).parts[0]).toBe("402 of 404 triangles (99 %)");
  });

  test("says what goes on", () => {
    expect(summaryOf(final, 50, true, voxels(1))).toEqual({ parts: ["50 triangles so far"], activity: "Working" });
    expect(summaryOf({ ...NOTHING_KNOWN, connection: "waiting" }, 0, false, voxels(1))).toEqual({ parts: [], activity: "Reconnecting" });
    expect(summaryOf({ ...final, openedShare: 0.4 }, 0, false, voxels(1)).activity).toBe("Opening, 40 %");
    const preparing = { ...final, openedShare: 0.4, preparing: { done: 12, of: 34 } };
    expect(summaryOf(preparing, 0, false, voxels(1)).activity).toBe("Preparing the device, 12 of 34");
    expect(hintText({ ...preparing, opening: true }, false)).toContain("Preparing the device, 12 of 34");
  });

  test("has the error measured, estimated with its sign, or not at all", () => {
    const both = { error: { rms: 0.0412, max: 0.31 }, estimatedError: { rms: 0.0523, worstLeaf: 1 }, fullTriangles: 9 };
    expect(errorWords([both], voxels(1))).toBe("error 0.041 voxels (RMS)");
    expect(errorWords([{ ...both, error: null }], voxels(1))).toBe("error ≈ 0.052 voxels (RMS)");
    expect(errorWords([{ ...both, error: null, estimatedError: null }], voxels(1))).toBeUndefined();
  });

  test("rounds times as a person does", () => {
    expect([40, 230, 949, 1234, 12_600].map(formatSeconds)).toEqual(["0.04 s", "0.2 s", "0.9 s", "1.2 s", "13 s"]);
  });
});

test("a view without a surface is explained", () => {
  const open = { ...NOTHING_KNOWN, connection: "connected" as const, volume: VOLUMES[0], view: OPENING, shown: { generation: 1, level: 0, final: true } };
  expect(hintText(open, false)).toMatch(/^No surface at isovalue 0: no sample on one side of it. Values go from /);
  const values = (value: number, count: number) => {
    const fields = VOLUMES[0]!.fields.map((field) => ({ ...field, range: [value, value] as const, histogram: { min: value, max: value, counts: [count] } }));
    return { ...open, volume: { ...VOLUMES[0]!, fields } };
  };
  expect(hintText(values(7, 99), false)).toBe("All values are 7: there is no surface");
  expect(hintText(values(0, 0), false)).toBe("No sample has a value: there is no surface");
  const thin = { ...VOLUMES[0]!, geometry: { ...VOLUMES[0]!.geometry, dims: [1, 9, 9] as const } };
  expect(hintText({ ...open, volume: thin }, false)).toMatch(/one sample thin/);
  expect(hintText({ ...open, view: { ...OPENING, minPart: 7 }, statistics: { ...statistics(0), removedParts: 3 } }, false)).toMatch(/All 3 parts are smaller than 7/);
  expect(hintText({ ...NOTHING_KNOWN, volumes: [] }, false)).toMatch(/no volumes/);
  expect(hintText(open, true)).toBe("Extracting the surface");
});

test("why a field opens with its isovalue is said as long as that is in force", () => {
  const depth = VOLUMES[0]!.fields[0]!;
  const { openingIso } = depth;
  expect(openingText(depth, openingIso!.iso)).toBe("Default: between two classes of values");
  const explanation = "without the background (92 % of the samples)";
  expect(openingText({ ...depth, openingIso: { ...openingIso!, explanation } }, openingIso!.iso)).toBe("Default: without the background (92\u00a0% of the samples)");
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

test("features that are computed are offered, with labels, and their range is the server's where it is not known", () => {
  const features = { "divergence(u,v,w)": { unit: "1/s", range: [-2, 3] as [number, number] }, "q-criterion(u,v,w)": { unit: null } };
  const volume = { ...VOLUMES[0]!, vectors: [{ components: ["u", "v", "w"] as [string, string, string], features }] };
  expect(otherFeatures(volume, "depth")).toEqual(["mean-curvature", "divergence(u,v,w)", "q-criterion(u,v,w)", "height"]);
  expect(otherFeatures(volume, "height")).not.toContain("mean-curvature");
  // Not the shown field, which has one value on its surface; measured ones before computed ones, these before labels.
  expect([bestOther(volume, "depth"), bestOther(volume, "height")]).toEqual(["height", "depth"]);
  const alone = { ...volume, fields: volume.fields.slice(0, 1) };
  expect(bestOther(alone, "depth")).toBe("mean-curvature");
  const labelled = { ...volume, vectors: [], fields: volume.fields.map((field, i) => (i === 0 ? { ...field, derivedFeatures: {} } : { ...field, labels: [] })) };
  expect(bestOther(labelled, "depth")).toBe("height");
  const info = (feature: string) => featureInfo(volume, { feature, field: "depth" });
  expect(info("divergence(u,v,w)")?.unit).toBe("1/s");
  expect([info("divergence(u,v,w)"), info("mean-curvature"), info("q-criterion(u,v,w)")].map(ownRange)).toEqual([undefined, undefined, undefined]);
  expect(ownRange(info("height"))).toEqual(volume.fields[1]?.range);
  expect(label("divergence(u,v,w)")).toBe("Divergence of u, v, w");
  expect(label("lambda2(u,v,w)")).toBe("λ₂ of u, v, w");
  expect(label("mean-curvature")).toBe("Mean curvature");
  expect([label("my field (x)"), label("constructor")]).toEqual(["my field (x)", "constructor"]);
});

describe("an edit", () => {
  test("clears what decided before, and nothing else", () => {
    const none = { beta: undefined, error: undefined, triangles: undefined, bytes: undefined };
    expect(complete({ beta: 0.1 })).toEqual({ ...none, beta: 0.1, minPart: 0, parts: null });
    expect(complete({ mesher: "marching-cubes" })).toEqual({ mesher: "marching-cubes", minPart: 0, parts: null });
    expect(complete({ triangles: 500, topology: "free" })).toEqual({ ...none, triangles: 500, topology: "free" });
    expect(complete({ error: "0.1vx", triangles: { share: 0.5 } })).toEqual({ ...none, error: "0.1vx", triangles: { share: 0.5 } });
    expect(Object.keys(complete({ error: 0 }))).toEqual(["error", "beta", "triangles", "bytes"]);
    expect(complete({ iso: 3 })).toEqual({ iso: 3 });
  });
});

test("the difference of two views makes one of the other", () => {
  const after: View = { ...OPENING, ...complete({ triangles: 500 }), iso: 3 };
  expect(difference(OPENING, after)).toEqual({ iso: 3, triangles: 500, beta: undefined, error: undefined, bytes: undefined });
  expect({ ...OPENING, ...difference(OPENING, after) }).toEqual(after);
  // The same budget without the error beside it: the server keeps what an edit does not name.
  const lifted: View = { ...OPENING, error: undefined };
  expect(difference(OPENING, lifted)).toMatchObject({ triangles: OPENING.triangles });
  expect(difference(OPENING, { ...OPENING })).toEqual({});
  expect(complete({ beta: 0.1 })).toMatchObject({ minPart: 0 });
});

describe("the slider of detail", () => {
  const found = { ...statistics(100), fullTriangles: 1000 };
  const view = (edit: Edit): View => ({ ...OPENING, ...complete(edit) });

  test("has equal factors, and ticks where they belong", () => {
    for (const { at, text } of SHARE_TICKS) expect(`${100 * SHARE_SCALE.toValue(at)} %`).toBe(text);
    expect([0, 1].map(SHARE_SCALE.toValue)).toEqual([0.001, 1]);
    expect([5, 1e-9].map(SHARE_SCALE.toPosition)).toEqual([1, 0]);
  });

  test("stands at the budget, or at what was made", () => {
    expect(shareOf(view({ triangles: { share: 0.25 } }), found, 1)).toBe(0.25);
    expect(shareOf(view({ triangles: { share: 0.25, max: 50 } }), found, 1)).toBe(0.05);
    expect(shareOf(view({ triangles: 20 }), found, 1)).toBe(0.02);
    expect(shareOf(view({ beta: 0.1 }), found, 1)).toBe(0.1);
    expect(shareOf(view({ beta: 0.1 }), undefined, 1)).toBeUndefined();
    expect(trianglesShown(view({ triangles: { share: 0.25 } }), found, 1)).toBe(250);
    expect(trianglesShown(view({ error: 1 }), found, 1)).toBe(100);
  });

  test("keeps a limit that the view has", () => {
    expect(budgetOf(0.5, view({ triangles: { share: 0.1, max: 9 } }))).toEqual({ share: 0.5, max: 9 });
    expect(budgetOf(0.5, view({ beta: 0 }))).toEqual({ share: 0.5 });
  });

  test("says what limits it, with the edit that ends it", () => {
    const limits = (edit: Edit, change: object = {}, refusal?: { code: string; suggestedTriangles: number }) => limitsOf(view(edit), { ...found, ...change }, refusal, voxels(1));
    expect(limits({ triangles: { share: 0.2 } })).toEqual([]);
    const points = [{ triangles: 1000, rms: 0, threshold: 0 }, { triangles: 400, rms: 0.02, threshold: 0.1 }, { triangles: 90, rms: 0.1, threshold: 1 }];
    const curve = { type: "curve", surface: 0, generation: 1, kind: "tree", byError: true, points } as const;
    const withCurve = (edit: Edit, at = curve) => limitsOf(view(edit), { ...found, tolerance: 3 }, undefined, { spacing: 1, unit: "mm" }, undefined, { ...at, points: [...at.points] });
    // Of the view's error, or of one that is hardly seen: both are a threshold of the curve.
    expect(withCurve({ error: "0.1vx", triangles: 100 })).toEqual([{ text: "0.1 mm needs 410 triangles", lift: { text: "Use 410", edit: { triangles: 410, error: "0.1vx" } } }]);
    expect(withCurve({ triangles: 100 })).toEqual([{ text: "0.1 mm needs 410 triangles", lift: { text: "Use 410", edit: { triangles: 410 } } }]);
    // Also for a typed budget, if no curve gives the number.
    expect(withCurve({ triangles: 100 }, { ...curve, byError: false } as never)).toEqual([{ text: "0.1 mm needs more triangles", lift: { text: "Remove budget", edit: { error: "0.1vx" } } }]);
    expect(limits({ triangles: 100 }, { tolerance: 0.05 })).toEqual([]);
    expect(limits({ beta: 0.5 })).toEqual([{ text: "β = 0.5 decides", lift: { text: "Limit by triangles", edit: { triangles: { share: 0.25 } } } }]);
    const both = { error: "0.1vx", triangles: { share: 0.25 } };
    expect(limits(both, { tolerance: 0.1 })[0]).toMatchObject({ lift: { edit: { triangles: { share: 0.25 } } } });
    expect(limits(both, { tolerance: 3 })[0]).toMatchObject({ lift: { edit: { error: "0.1vx" } } });
    expect(limits(both, { tolerance: 3, gaveWay: ["max-error", "topology"], vanishedParts: null })[0]?.text).toBe(
      "0.1 voxels needs more triangles. Error ≈ 0.05 voxels (RMS). Topology not kept: the budget is too small",
    );
    expect(limits(both, { tolerance: 3, gaveWay: ["max-error"], error: { rms: 0.2, max: 1.58 }, estimatedError: null })[0]?.text).toContain("Max. error 1.6 voxels");
    expect(limits({ triangles: { share: 0.5, max: 10 } })[0]).toMatchObject({ lift: { edit: { triangles: { share: 0.5 } } } });
    const refused = { code: "over-budget", suggestedTriangles: 77 };
    expect(limits({ triangles: 9 }, {}, refused)[0]).toMatchObject({ lift: { text: "Make 77", edit: { triangles: 77 } } });
    expect(limits({ triangles: 9, topology: "preserve" }, {}, refused)[0]).toMatchObject({ lift: { edit: { topology: "auto", maxError: "auto" } } });
  });
});

describe("keys on a slider", () => {
  const STEPS = 1000;
  const press = (scale: typeof SHARE_SCALE, value: number, by: number) => valueAfter(scale, value, Math.round(scale.toPosition(value) * STEPS), by, STEPS);

  test.each([
    ["share", SHARE_SCALE, 0.001, 1],
    ["β", BETA_SCALE, -1, 1],
    ["error", ERROR_SCALE, 0.01, 4],
  ] as const)("of %s always change it, from one end to the other and back", (_name, scale, low, high) => {
    let value: number = low;
    for (let next = press(scale, value, 1); next !== undefined; next = press(scale, value, 1)) {
      expect(next).toBeGreaterThan(value);
      value = next;
    }
    expect(value).toBe(high);
    for (let next = press(scale, value, -1); next !== undefined; next = press(scale, value, -1)) {
      expect(next).toBeLessThan(value);
      value = next;
    }
    expect(value).toBe(low);
  });

  test("move it by more with Shift, and not past its end", () => {
    expect(press(SHARE_SCALE, 0.05, 10)).toBeGreaterThan(press(SHARE_SCALE, 0.05, 1) ?? 1);
    expect([press(SHARE_SCALE, 0.99, 10), press(SHARE_SCALE, 1, 10)]).toEqual([1, undefined]);
  });
});

test("peeling goes from level to level, up to the coarsest that has triangles", () => {
  const triangles = [10, 20, 0, 5, 0, 0];
  expect([0, 2, 3, 5].map((level) => nextLevel(level, triangles))).toEqual([1, 3, undefined, undefined]);
  expect(nextLevel(0, [])).toBeUndefined();
});

describe("isovalues worth trying", () => {
  const counts = Array.from({ length: 256 }, (_, bin) => Math.round(1000 * Math.exp(-(((bin - 60) / 12) ** 2)) + 400 * Math.exp(-(((bin - 180) / 15) ** 2))));
  const field = { ...VOLUMES[0]!.fields[0]!, histogram: { min: 0, max: 256, counts } };

  test("are the opening, Otsu's threshold and peaks", () => {
    const marks = landmarks({ ...field, openingIso: { iso: 20, reason: "whole-histogram", explanation: "two classes" } });
    expect(marks.map(({ name }) => name)).toEqual(["default", "Otsu threshold", "peak 61", "peak 181"]);
    const otsu = marks[1]!.iso;
    expect(otsu).toBeGreaterThan(90);
    expect(otsu).toBeLessThan(150);
    expect(landmarks(field, 20).map(({ name }) => name).slice(0, 2)).toEqual(["default", "threshold"]);
  });

  test("are those of the body in Hounsfield units, where the values reach", () => {
    const ct = { ...field, unit: "HU", histogram: { min: -1000, max: 2000, counts } };
    const names = (unit: string | null) => landmarks({ ...ct, unit }).map(({ name }) => name);
    expect(names("HU")).toEqual(["default", "lung", "skin", "vessels", "bone"]);
    expect(names("mm").filter((name) => !name.startsWith("peak"))).toEqual(["default", "Otsu threshold"]);
  });

  test("are none where there is one value", () => {
    expect(landmarks({ ...field, histogram: { min: 3, max: 3, counts: [9] } })).toEqual([]);
  });
});

test("α is said in words", () => {
  expect([0, 0.3, 1].map((alpha) => alphaText(alpha, "gradient-magnitude"))).toEqual(["shape alone", "70 % shape, 30 % edges", "edges alone"]);
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
    const errors = (error: { rms: number; max: number } | null) => ({ error, estimatedError: { rms: 0.2, worstLeaf: 0.64 }, vanishedParts: null });
    expect(gaveWayText("max-error", errors({ rms: 0.3, max: 3.2 }), voxels(2))).toBe("Max. error 1.6 voxels");
    expect(gaveWayText("max-error", errors(null), voxels(2))).toBe("Error ≈ 0.1 voxels (RMS)");
    expect(gaveWayText("topology", errors(null), voxels(2))).toBe("Topology not kept: the budget is too small");
    const vanished = (vanishedParts: number) => gaveWayText("topology", { ...errors(null), vanishedParts }, voxels(2));
    expect([1, 1200].map(vanished)).toEqual(["1 small part left out: the budget is too small", "1,200 small parts left out: the budget is too small"]);
  });
});
