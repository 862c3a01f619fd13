import { describe, expect, test } from "vitest";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK, type Look } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { fieldBarOf, fieldScaleOf, linePlaces, logProblem, valueAt } from "../src/ui/cards/fieldColors";
import { OPENING, VOLUMES } from "./fixture";

const LOOK: Look = { ...DEFAULT_LOOK, colorBy: "field" };
const viewOf = (low: number, high: number) => ({ ...OPENING, feature: "depth", featureRange: [low, high] as const });
const linesOf = (look: Partial<Look>, low: number, high: number) => fieldScaleOf({ ...LOOK, ...look }, viewOf(low, high), VOLUMES[0])?.lines;

describe("isolines", () => {
  test("are at round values inside the range, not more than asked for", () => {
    expect(linesOf({ isolines: 8 }, 0, 255)).toEqual([50, 100, 150, 200, 250]);
    expect(linesOf({ isolines: 3 }, -1, 1)).toEqual([-0.5, 0, 0.5]);
    expect(linesOf({ isolines: 0 }, 0, 255)).toEqual([]);
    for (const count of [1, 2, 5, 24]) expect(linesOf({ isolines: count }, 3, 977)?.length).toBeLessThanOrEqual(count);
  });

  test("of a log scale are at round digits of each decade, at decades, and at some of these", () => {
    const log = (isolines: number, low: number, high: number) => linesOf({ isolines, logColors: true, colorRange: [low, high] }, low, high);
    expect(log(6, 0.3, 40)).toEqual([0.5, 1, 2, 5, 10, 20]);
    expect(log(4, 0.3, 400)?.map((value) => Number(value.toPrecision(3)))).toEqual([1, 10, 100]);
    expect(log(3, 1e-6, 1e6)?.length).toBe(3);
    expect(log(9, 1e-6, 1e6)?.every((value) => Number.isInteger(Math.log10(value)))).toBe(true);
    // Less than a decade has round numbers.
    expect(log(8, 2, 9)).toEqual([3, 4, 5, 6, 7, 8]);
  });

  test("are never where whole triangles may lie, as the feature comes in steps", () => {
    const scale = fieldScaleOf({ ...LOOK, isolines: 3 }, viewOf(0, 65535), VOLUMES[0])!;
    expect(scale.lines).toEqual([20000, 40000, 60000]);
    for (const [i, at] of linePlaces({ ...scale, lines: [256 * 100, 20000] }).entries()) {
      const steps = (at * 65535) / 256;
      expect(Math.abs(steps - Math.round(steps))).toBeGreaterThan(0.1);
      expect(Math.abs(at * 65535 - [25600, 20000][i]!)).toBeLessThan(65);
    }
  });
});

describe("a log scale", () => {
  test("begins above 0, and says so", () => {
    const look: Look = { ...LOOK, logColors: true };
    expect(fieldScaleOf(look, viewOf(0, 100), VOLUMES[0])).toMatchObject({ log: true, range: [0.1, 100] });
    expect(logProblem(look, viewOf(0, 100), VOLUMES[0])).toBe("begins-above-0");
    expect(fieldScaleOf(look, viewOf(-5, -1), VOLUMES[0])).toMatchObject({ log: false, range: [-5, -1] });
    expect(logProblem(look, viewOf(-5, -1), VOLUMES[0])).toBe("linear");
    expect(logProblem(look, viewOf(1, 100), VOLUMES[0])).toBeUndefined();
    expect(logProblem(LOOK, viewOf(-5, -1), VOLUMES[0])).toBeUndefined();
  });

  test("has the geometric mean in its middle", () => {
    const scale = fieldScaleOf({ ...LOOK, logColors: true }, viewOf(1, 100), VOLUMES[0])!;
    expect(valueAt(scale, 0.5)).toBeCloseTo(10);
    expect(fieldBarOf(scale, viewOf(1, 100), VOLUMES[0]).texts).toEqual(["1", "10", "100"]);
  });
});

test("a range that was set is one of the field of the legend", () => {
  const look: Look = { ...LOOK, colorRange: [3, 4] };
  expect(fieldScaleOf(look, viewOf(0, 10), VOLUMES[0])?.range).toEqual([3, 4]);
  expect(fieldScaleOf(look, viewOf(0, 10), VOLUMES[0], { ...viewOf(0, 1), feature: "height" })?.range).toEqual([0, 10]);
});

describe("a field for colours alone", () => {
  const view = { ...viewOf(0, 10), colorField: "height" };

  test("has its own range, name and unit, and values without steps", () => {
    const height = VOLUMES[0]!.fields.find(({ name }) => name === "height")!;
    const scale = fieldScaleOf({ ...LOOK, isolines: 3 }, view, VOLUMES[0])!;
    expect(scale).toMatchObject({ ofValues: true, known: height.range, range: height.range });
    const [low, high] = height.range;
    expect(linePlaces(scale)).toEqual(scale.lines.map((value) => (value - low) / (high - low)));
    expect(fieldBarOf(scale, view, VOLUMES[0]).title).toBe(height.unit === null ? "height" : `height, in ${height.unit}`);
  });

  test("needs no feature, and does not take the range of the feature", () => {
    expect(fieldScaleOf(LOOK, { ...view, feature: "none" }, VOLUMES[0])?.ofValues).toBe(true);
    const look: Look = { ...LOOK, colorRange: [3, 4] };
    expect(fieldScaleOf(look, view, VOLUMES[0])?.range).toEqual([3, 4]);
    expect(fieldScaleOf(look, view, VOLUMES[0], viewOf(0, 10))?.range).not.toEqual([3, 4]);
  });

  test("that is an expression has a range once one is chosen", () => {
    const computed = { ...view, colorField: "log(height)" };
    expect(fieldScaleOf(LOOK, computed, VOLUMES[0])).toBeUndefined();
    expect(fieldScaleOf({ ...LOOK, colorRange: [-1, 2] }, computed, VOLUMES[0])).toMatchObject({ ofValues: true, range: [-1, 2] });
  });

  test("is in links; old links have none", () => {
    const surfaces = [{ number: 0, view: { ...OPENING, colorField: "height*2" }, style: DEFAULT_STYLE }];
    const link = encodeLink({ volume: "a", step: 0, surfaces, selected: 0, opening: OPENING, look: LOOK, openingLook: DEFAULT_LOOK, pose: undefined });
    expect(decodeLink(link)?.surfaces[0]?.edit.colorField).toBe("height*2");
    expect(decodeLink("volume=a&iso=1")?.surfaces[0]?.edit.colorField).toBeUndefined();
  });
});

test("texts of isolines do not overlap", () => {
  const scale = fieldScaleOf({ ...LOOK, isolines: 24 }, viewOf(0, 255), VOLUMES[0])!;
  const { lines, texts } = fieldBarOf(scale, viewOf(0, 255), VOLUMES[0]);
  expect(texts).toEqual(["0", "255"]);
  expect(lines).toHaveLength(12);
  const said = lines.filter(({ text }) => text !== "").map(({ at }) => at);
  for (const [i, at] of said.entries()) expect(at - (said[i - 1] ?? 0)).toBeGreaterThan(0.08);
});

test("links hold all of it, and say what is wrong", () => {
  const look: Look = { ...LOOK, colorRange: [0.5, 40], logColors: true, isolines: 6 };
  const surfaces = [{ number: 0, view: OPENING, style: DEFAULT_STYLE }];
  const link = encodeLink({ volume: "a", step: 0, surfaces, selected: 0, opening: OPENING, look, openingLook: DEFAULT_LOOK, pose: undefined });
  expect(link).toContain("&colors=0.5,40&isolines=6&");
  expect({ ...DEFAULT_LOOK, ...decodeLink(link)?.look }).toEqual(look);
  expect(() => decodeLink("volume=a&colors=4,3")).toThrow("This link's “colors” is 4,3, expected a range from a lower to a higher value");
  expect(() => decodeLink("volume=a&isolines=2.5")).toThrow("expected a whole number up to 24");
});
