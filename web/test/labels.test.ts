import { describe, expect, test } from "vitest";
import type { FieldInfo, View, VolumeInfo } from "../src/protocol/types";
import { decodeLink, encodeLink } from "../src/state/link";
import { around, colorFor, importanceEdit, joinedLabel, labelByNumber, labelFields, labelsAround, labelsIn, labelsKept, labelsName, labelsNear, maskEdit, matching, samplesVolume, shownLabel, smoothedLabels, surfacesAround, type LabelEntry } from "../src/state/labels";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE, type SurfaceList } from "../src/state/surfaceList";
import { OPENING, VOLUMES } from "./fixture";

const BASE = VOLUMES[0]!;
/** Counts of values from 0 to `last` in 256 bins. */
function counts(last: number, samples: Readonly<Record<number, number>>): number[] {
  const bins = new Array<number>(256).fill(0);
  for (const [value, n] of Object.entries(samples)) bins[Math.min(255, Math.floor((Number(value) * 256) / last))]! += n;
  return bins;
}

function fieldOf(last: number, samples: Readonly<Record<number, number>>, labels?: FieldInfo["labels"]): FieldInfo {
  return {
    name: "seg",
    type: "u8",
    unit: null,
    range: [0, last],
    histogram: { min: 0, max: last, counts: counts(last, samples) },
    openingIso: { iso: 0.5, reason: "labels", explanation: "around all labels" },
    derivedFeatures: {},
    ...(labels && { labels }),
  };
}

const label = (number: number, name = `L${number}`): LabelEntry => ({ number, name, color: "#112233", samples: 8 });
const ALL = [3, 7, 17, 18].map((number) => label(number));

describe("the labels of a field", () => {
  test("are those of its table that some sample has, without the background", () => {
    const table = [
      { value: 0, name: "Unknown", color: "#000000" },
      { value: 3, name: "Pons", color: "#ff0000" },
      { value: 4, name: "Nowhere", color: null },
      { value: 17, name: null, color: null },
    ];
    const labels = labelsIn(fieldOf(95, { 0: 5000, 3: 40, 17: 2 }, table), { dims: [10, 10, 60] });
    expect(labels).toEqual([
      { number: 3, name: "Pons", color: "#ff0000", samples: 40 },
      { number: 17, name: "Label 17", color: colorFor(17), samples: 2 },
    ]);
  });

  test("are the values of its histogram where there is no table, and typed where values share a bin", () => {
    expect(labelsIn(fieldOf(200, { 0: 90, 1: 4, 200: 3, 199: 1 }), { dims: [10, 10, 1] }).map(({ number, samples }) => [number, samples])).toEqual([[1, 4], [199, 1], [200, 3]]);
    const wide = fieldOf(2035, { 0: 90, 1012: 7 });
    expect(labelsIn(wide, { dims: [10, 10, 1] })).toEqual([]);
    expect(labelByNumber(wide, " 1012 ")).toMatchObject({ number: 1012, name: "Label 1012", samples: undefined });
    for (const text of ["0", "2036", "-1", "1.5", "bone", ""]) expect(labelByNumber(wide, text)).toBeUndefined();
    // Of a large volume a share of the planes is counted: nothing is known to be absent.
    expect(labelsIn(fieldOf(95, {}, [{ value: 3, name: "Pons", color: null }]), { dims: [1024, 1024, 1024] })).toMatchObject([{ number: 3, samples: undefined }]);
  });

  test("have the numbers of the file where samples have others", () => {
    const large = { ...fieldOf(9, { 0: 1, 1: 5 }), labels: [{ value: 1, stored: "16777217", name: "A", color: null }] };
    expect(labelsIn(large, { dims: [2, 3, 1] })).toMatchObject([{ number: 16777217, samples: 5 }]);
  });

  test("are found by name or number, and fields by having some", () => {
    const labels = [label(7, "Left Hippocampus"), label(17, "Right Hippocampus"), label(70, "Pons")];
    expect(matching(labels, "HIPPO").map(({ number }) => number)).toEqual([7, 17]);
    expect(matching(labels, "7").map(({ number }) => number)).toEqual([7, 70]);
    expect(matching(labels, "  ")).toHaveLength(3);
    expect(labelFields({ ...BASE, fields: [...BASE.fields, fieldOf(3, {})] }).map(({ name }) => name)).toContain("seg");
    expect(labelFields(undefined)).toEqual([]);
  });

  test("have the volume of their samples, where all cells have the same", () => {
    const geometry: VolumeInfo["geometry"] = { ...BASE.geometry, spacing: [1, 2, 3], direction: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] };
    expect(samplesVolume(4, geometry)).toBeCloseTo(24);
    expect(samplesVolume(4, { ...geometry, positions: [null, [0, 1, 3], null] })).toBeUndefined();
  });

  test("have colours that differ, each the same every time", () => {
    const colors = Array.from({ length: 60 }, (_, i) => colorFor(i - 3));
    expect(new Set(colors).size).toBe(60);
    for (const color of colors) expect(color).toMatch(/^#[0-9a-f]{6}$/);
  });
});

describe("expressions around labels", () => {
  test("are read as they are written, and as the command line writes them", () => {
    for (const of of [{ field: "seg", values: "3", smoothing: 0.8 }, { field: "my seg", values: "3,17", smoothing: 0 }, { field: "seg", values: "3,17", smoothing: 1.5 }]) expect(labelsAround(around(of))).toEqual(of);
    expect(around({ field: "seg", values: "3,17", smoothing: 0 })).toBe('if("seg"==3||"seg"==17,1,0)');
    expect(around({ field: "seg", values: "3,17", smoothing: 0.8 })).toBe("smooth(0.8,seg==3,17)");
    expect(labelsAround('smooth(0.8,"seg"==3||"seg"==17)')).toEqual({ field: "seg", values: "3,17", smoothing: 0.8 });
    for (const other of ["seg", "log(seg)", 'if("seg"==3||"t1"==4,1,0)', "if(seg>3,1,0)", "if(seg==3,1,2)", "distance(seg==3)"]) expect(labelsAround(other)).toBeUndefined();
  });

  test("are called by the names of their labels", () => {
    const volume = { fields: [fieldOf(95, {}, [{ value: 3, name: "Pons", color: null }, { value: 4, name: "Vermis", color: null }])] };
    expect([labelsName(volume, "smooth(0.8,seg==3)"), labelsName(volume, "smooth(0.8,seg==3,9)"), labelsName(volume, "smooth(0.8,seg==9)"), labelsName(volume, "smooth(0.8,seg==9,8)"), labelsName(volume, "seg")]).toEqual(["Pons", "Pons, 9", "Label 9", "Labels 9, 8", undefined]);
    expect(labelsName(volume, "smooth(0.8,seg==3,4,5,6)")).toBe("Pons, Vermis and 2 more");
  });
});

describe("importance and masks of labels", () => {
  const view: View = { ...OPENING, feature: "gradient-magnitude", featureRange: [0, 5] };
  const around = { opening: view, extent: 200 };

  test("importance falls with the distance to labels, and is as before without any", () => {
    const first = importanceEdit(view, "seg", label(7), ALL, around);
    expect(first).toMatchObject({ feature: "distance(seg==7)", featureRange: [0, 20], alpha: 1 });
    expect(first.transferFunction?.points.map(({ x, importance }) => [x, importance])).toEqual([[0, 1], [1, 0]]);
    const narrowed = { ...view, ...first, featureRange: [0, 9] as const };
    const second = importanceEdit(narrowed, "seg", label(3), ALL, around);
    expect(second).toEqual({ feature: "distance(seg==7,3)", featureRange: [0, 9] });
    expect(labelsNear("distance(seg==7,3)", "seg")).toBe("7,3");
    expect([labelsNear("distance(other==7)", "seg"), labelsNear("gradient-magnitude", "seg")]).toEqual(["", ""]);
    expect(importanceEdit({ ...view, feature: "distance(seg==7)" }, "seg", label(7), ALL, around)).toEqual({ feature: view.feature, featureRange: [0, 5], alpha: view.alpha, transferFunction: view.transferFunction });
  });

  test("a mask keeps some labels, and none when the last is taken out", () => {
    expect(maskEdit(view, "seg", label(7), ALL)).toEqual({ mask: "seg==7" });
    expect(maskEdit({ ...view, mask: "seg==7" }, "seg", label(18), ALL)).toEqual({ mask: "seg==7,18" });
    expect(maskEdit({ ...view, mask: "seg==7,18" }, "seg", label(7), ALL)).toEqual({ mask: "seg==18" });
    expect(maskEdit({ ...view, mask: "seg==18" }, "seg", label(18), ALL)).toEqual({ mask: null });
    // A range is taken apart.
    expect(maskEdit({ ...view, mask: "seg==1..95" }, "seg", label(7), ALL)).toEqual({ mask: "seg==3,17..18" });
    expect([labelsKept("seg==3", "seg"), labelsKept("seg>=3", "seg"), labelsKept("t1==3", "seg"), labelsKept(null, "seg")]).toEqual(["3", "", "", ""]);
  });
});

describe("surfaces around labels", () => {
  const base: SurfaceList = [{ number: 0, view: { ...OPENING, triangles: 9000 }, style: DEFAULT_STYLE }];
  const of = (number: number, max = 3) => ({ field: "seg", label: label(number), smoothing: 0.8, opening: OPENING, max });

  test("are added in their colour, seen through the others, hidden and shown again", () => {
    const one = shownLabel(base, of(7))!;
    expect(one.map(({ number, view, style }) => [number, view.field, view.iso, style.visible, style.opacity, style.color])).toEqual([
      [0, OPENING.field, OPENING.iso, true, 0.35, undefined],
      [1, "smooth(0.8,seg==7)", 0.5, true, 1, "#112233"],
    ]);
    expect(one[1]!.view).toMatchObject({ feature: "none", triangles: 9000, mask: null });
    const hidden = shownLabel(one, of(7))!;
    expect(hidden.map(({ style }) => style.visible)).toEqual([true, false]);
    expect(shownLabel(hidden, of(7))).toEqual(one);
    expect(surfacesAround(one, "seg", 7)).toHaveLength(1);
    expect(surfacesAround(one, "other", 7)).toHaveLength(0);
    // What was made opaque by hand stays so.
    const opaque = one.map((surface) => ({ ...surface, style: { ...surface.style, opacity: 1 } }));
    expect(shownLabel(opaque, of(17))!.map(({ style }) => style.opacity)).toEqual([1, 1, 1]);
  });

  test("take the place of hidden ones where there are as many as can be, and else are joined", () => {
    const two = shownLabel(shownLabel(base, of(7))!, of(17))!;
    expect(two).toHaveLength(3);
    expect(shownLabel(two, of(18))).toBeUndefined();
    const joined = joinedLabel(two, of(18))!;
    expect(joined.map(({ view }) => view.field)).toEqual([OPENING.field, "smooth(0.8,seg==7)", "smooth(0.8,seg==17,18)"]);
    expect(joinedLabel(base, of(18))).toBeUndefined();
    const hidden = shownLabel(two, of(7))!;
    expect(shownLabel(hidden, of(18))!.map(({ number, view, style }) => [number, view.field, style.visible])).toEqual([
      [0, OPENING.field, true],
      [1, "smooth(0.8,seg==18)", true],
      [2, "smooth(0.8,seg==17)", true],
    ]);
    expect(smoothedLabels(joined, 0).map(({ view }) => view.field)).toEqual([OPENING.field, 'if("seg"==7,1,0)', 'if("seg"==17||"seg"==18,1,0)']);
    const ranges = [{ ...joined[1]!, view: { ...OPENING, field: "smooth(0.8,seg==1,4..7)" } }];
    expect(smoothedLabels(ranges, 0)).toEqual(ranges);
    expect(smoothedLabels(ranges, 1.5)[0]!.view.field).toBe("smooth(1.5,seg==1,4..7)");
    let full = joined;
    for (let number = 20; number < 60; number += 1) full = joinedLabel(full, of(number)) ?? full;
    expect(labelsAround(full[2]!.view.field)!.values.split(",")).toHaveLength(16);
  });

  test("are in links", () => {
    const surfaces = shownLabel(base, of(7))!;
    const state = { volume: "head", step: 0, surfaces, selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined };
    const link = decodeLink(encodeLink(state))!;
    expect(link.surfaces[1]).toMatchObject({ edit: { field: "smooth(0.8,seg==7)", iso: 0.5, feature: "none" }, style: { color: "#112233" } });
  });
});
