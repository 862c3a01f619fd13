import { describe, expect, test } from "vitest";
import type { SurfaceRenderer } from "../src/scene/renderer";
import { decodeLink, encodeLink, type LinkState } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { amountOf, MAX_MEASURES, measuresCsv, measureText, readMeasure, type Measure } from "../src/state/measure";
import { amountWords, measureWords } from "../src/ui/cards/measureWords";
import { Measuring } from "../src/wiring/marks";
import { OPENING, VOLUMES, voxels } from "./fixture";

const distance: Measure = { kind: "distance", points: [[0, 0, 0], [3, 4, 0]] };
const angle: Measure = { kind: "angle", points: [[1, 0, 0], [0, 0, 0], [1, 1, 0]] };
const reading: Measure = { kind: "reading", points: [[1.5, -2, 1e-3]], values: [0.25, null] };

describe("amounts", () => {
  test("are lengths and angles", () => {
    expect(amountOf(distance)).toBe(5);
    expect(amountOf(angle)).toBeCloseTo(45);
    expect(amountOf({ ...angle, points: [[1, 0, 0], [0, 0, 0], [-2, 0, 0]] })).toBe(180);
    // An angle whose cosine is 1 in single precision.
    expect(amountOf({ ...angle, points: [[1, 0, 0], [0, 0, 0], [1, 1e-4, 0]] })).toBeCloseTo(0.0057296, 7);
    expect(amountOf({ ...angle, points: [[1, 0, 0], [0, 0, 0], [0, 0, 0]] })).toBeNaN();
    expect(amountOf(reading)).toBeNaN();
  });

  test("are said", () => {
    expect([distance, angle, reading].map((measure) => amountWords(measure, undefined))).toEqual(["5", "45°", "0.25 · –"]);
    expect(measureWords(distance, VOLUMES[0], voxels(0.5))).toBe("Distance 5, 10 voxels");
    expect(measureWords(distance, VOLUMES[0], { spacing: 0.5, unit: "mm" })).toBe("Distance 5 mm, 10 voxels");
    expect(measureWords(angle, VOLUMES[0], voxels(1))).toBe("Angle 45°");
    expect(measureWords(reading, VOLUMES[0], voxels(1))).toBe("depth 0.25 mm, height not known");
    expect(amountWords({ ...angle, points: [[0, 0, 0], [0, 0, 0], [1, 0, 0]] }, undefined)).toBe("no angle");
  });
});

describe("a link", () => {
  const state: LinkState = { volume: "ball", step: 0, surfaces: [{ number: 0, view: OPENING, style: DEFAULT_STYLE }], selected: 0, opening: OPENING, look: { ...DEFAULT_LOOK, measures: [distance, angle, reading] }, openingLook: DEFAULT_LOOK, pose: undefined };

  test("keeps what was measured", () => {
    expect(encodeLink(state)).toBe("v=1&volume=ball&iso=0&measure=d,0,0,0,3,4,0;a,1,0,0,0,0,0,1,1,0;r,1.5,-2,0.001,0.25,");
    expect(decodeLink(encodeLink(state))?.look).toEqual({ measures: [distance, angle, reading] });
    expect(encodeLink({ ...state, look: DEFAULT_LOOK })).not.toContain("measure");
    const many = `volume=ball&measure=${new Array(MAX_MEASURES + 5).fill("d,0,0,0,3,4,0").join(";")}`;
    expect(decodeLink(many)?.look.measures).toHaveLength(MAX_MEASURES);
  });

  test.each([
    ["x,1,2,3", /“measure” begins with "x", expected d, a, r or l/],
    ["d,1,2,3", /“measure” has 3 numbers, expected 6/],
    ["d,1,2,3,4,5,6,7", /has 7 numbers, expected 6/],
    ["a,1,2,3,4,5,6,7,8,no", /is "no", expected a number/],
    ["r,1,2", /has 2 numbers, expected 3/],
    ["r,1,2,3,high", /is "high", expected a number/],
  ])("with %s is refused", (text, message) => {
    expect(() => readMeasure(text)).toThrow(message);
  });
});

test("the table has a line for each, with units, points and values", () => {
  const fields = [{ ...VOLUMES[0]!.fields[0]!, name: "T1, \"raw\"", unit: "mm" }, VOLUMES[0]!.fields[1]!];
  expect(measuresCsv([distance, angle, reading], { ...VOLUMES[0]!, id: "a,b", fields }).split("\r\n")).toEqual([
    'volume,number,kind,amount,unit,x1,y1,z1,x2,y2,z2,x3,y3,z3,"T1, ""raw"" (mm)",height',
    '"a,b",1,distance,5,world units,0,0,0,3,4,0,,,,,',
    '"a,b",2,angle,45,degrees,1,0,0,0,0,0,1,1,0,,',
    '"a,b",3,reading,,,1.5,-2,0.001,,,,,,,0.25,',
    "",
  ]);
});

test("the scene shows what is measured and what is begun; what is as before costs no frame", () => {
  const marks: number[] = [];
  const texts: string[][] = [];
  const annotations = { mark: (all: readonly unknown[]) => marks.push(all.length), measure: (all: readonly { text: string; at: readonly number[] }[]) => texts.push(all.map(({ text, at }) => `${text} at ${at.join()}`)) };
  const measuring = new Measuring({ annotations } as unknown as SurfaceRenderer);
  const [none, some, begun] = [[], [distance, angle], [[9, 9, 9], [8, 8, 8]] as const];
  measuring.show(none, none, undefined);
  expect(marks).toEqual([]);
  measuring.show(some, none, undefined);
  measuring.show(some, none, undefined);
  measuring.show(some, begun, undefined);
  measuring.show([], [], undefined);
  measuring.show([], [], undefined);
  expect(marks).toEqual([5, 7, 0]);
  expect(texts).toEqual([["1 · 5 at 1.5,2,0", "2 · 45° at 0,0,0"], ["1 · 5 at 1.5,2,0", "2 · 45° at 0,0,0", " at 8,8,8"], []]);
});

test("labels keep what parts measurements in a link", () => {
  const label = { kind: "label", points: [[1, 2, 3]], text: "A, b; c ~ ü" } as const;
  expect(readMeasure(measureText(label))).toEqual(label);
  expect(measureText(label)).not.toMatch(/[; ]/);
  expect(() => readMeasure("l,1,2,3,%E0%A4%A")).toThrow("which was cut off or changed");
  expect(readMeasure("l,1,2,3")).toEqual({ ...label, text: "" });
});
