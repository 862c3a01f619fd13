import { describe, expect, test } from "vitest";
import { Annotations, type Annotation } from "../src/regions/annotations";
import { emptyMap, heldChunk, reduce, type RegionEvent } from "../src/regions/map";
import { awaitedDistances, dueQuestions, measuredDistances } from "../src/state/answers";
import { distancesOf } from "../src/state/distances";
import { awaitedErrors, dueErrors, shownErrors } from "../src/state/shownErrors";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import type { StateEvent } from "../src/state/reduce";
import type { ViewerState } from "../src/state/viewer";
import { NOTHING_KNOWN, run as next } from "./acting";
import { distanceWords } from "../src/ui/words";
import { CAPABILITIES, OPENING, statistics, VOLUMES, voxels } from "./fixture";

const floats = (...values: number[]) => Float32Array.from(values);

describe("distances taken together", () => {
  test("end where 98 % of the vertices are nearer, rounded up", () => {
    const even = Float32Array.from({ length: 1000 }, (_, i) => i / 1000);
    const { share, upper, farthest } = distancesOf([even.slice(0, 300), even.slice(300)], 1);
    expect(share).toBe(0.98);
    expect(upper).toBeGreaterThanOrEqual(0.98);
    expect(upper).toBeLessThanOrEqual(0.99);
    expect(farthest).toBeCloseTo(0.999);
    // One that is far off does not make all others look alike.
    expect(distancesOf([floats(...even, 1e6)], 1).upper).toBeLessThan(1);
  });

  test("of a surface without error are none, and those that are not near are said", () => {
    expect(distancesOf([floats(0, 0, 0)], 2)).toEqual({ share: 0.98, upper: 0.002, farthest: 0 });
    expect(distancesOf([], 1)).toEqual({ share: 0.98, upper: 0.001, farthest: 0 });
    expect(distancesOf([floats(0.5, 0.5, 1e30)], 1).farthest).toBe(Infinity);
    expect(distancesOf([floats(1e30, 1e30)], 1).upper).toBe(1e29);
  });

  test("are said in voxels", () => {
    expect(distanceWords({ share: 0.98, upper: 0.3, farthest: 1.2 }, [{ rms: 0.1, max: 0.7 }, { rms: 0.2, max: 0.4 }], voxels(0.5))).toBe("Darkest: error 0.6 voxels and more, around 2 % of the vertices; the measured maximum is 1.4 voxels");
    expect(distanceWords({ share: 0.98, upper: 0.3, farthest: Infinity }, [{ rms: 0.1, max: 0.7 }, null], voxels(1))).toBe("Darkest: error 0.3 voxels and more, around 2 % of the vertices");
    expect(distanceWords({ share: 0.98, upper: 0.001, farthest: 0 }, [], voxels(1))).toBe("Darkest: error 0.001 voxels");
  });
});

describe("an annotation", () => {
  const of = { surface: 0, generation: 3 };
  function receiver() {
    const given: number[] = [];
    const whole: Annotation[] = [];
    const annotations = new Annotations((id) => given.push(id), (annotation) => whole.push(annotation));
    const begin = (regions: number) => annotations.begin({ type: "annotated", ...of, annotation: "error", regions });
    const add = (id: number | undefined, isShown: boolean) => annotations.add({ ...of, values: floats(1) }, id, isShown);
    return { annotations, begin, add, given, whole };
  }

  test("is complete when all of it came and its meshes are on screen", () => {
    const { annotations, begin, add, given, whole } = receiver();
    begin(3);
    add(1, true);
    add(2, false);
    add(undefined, false);
    expect([given, whole]).toEqual([[1], []]);
    annotations.shown([2, 7]);
    expect(given).toEqual([1, 2]);
    expect(whole).toEqual([{ ...of, values: [floats(1), floats(1)] }]);
    begin(0);
    expect(whole).toHaveLength(2);
  });

  test("does not wait for meshes that will never be shown, and ends with the connection", () => {
    const { annotations, begin, add, given, whole } = receiver();
    begin(1);
    add(2, false);
    annotations.dropped([2]);
    expect([given, whole.length]).toEqual([[], 1]);
    begin(1);
    annotations.reset();
    expect(() => add(1, true)).toThrow(/not announced/);
  });

  test("of more regions, another surface or generation than announced is refused", () => {
    const { annotations, begin, add } = receiver();
    begin(1);
    for (const wrong of [{ surface: 1 }, { generation: 4 }]) {
      expect(() => annotations.add({ ...of, ...wrong, values: floats(1) }, 1, true)).toThrow(/not announced/);
    }
    add(1, true);
    expect(() => add(2, true)).toThrow(/not announced/);
  });
});

test("the chunk of a region that the client holds is the last that was committed", () => {
  const map = emptyMap();
  const run = (...events: RegionEvent[]) => events.forEach((event) => reduce(map, event));
  const prefix = (regions: number, id: number, region = "a"): RegionEvent[] => [
    { type: "prefix", generation: id, level: 0, regions, final: true },
    { type: "chunk", generation: id, level: 0, region, id },
    { type: "committed", generation: id, level: 0 },
  ];
  expect(heldChunk(map, "a")).toBeUndefined();
  run(...prefix(1, 1), { type: "resident", id: 1 });
  expect(heldChunk(map, "a")).toBe(1);
  run(...prefix(1, 2));
  expect([map.shown.get("a"), heldChunk(map, "a")]).toEqual([1, 2]);
  run(...prefix(1, 3).slice(0, 2));
  expect(heldChunk(map, "a")).toBe(2);
  run({ type: "reset" });
  expect(heldChunk(map, "a")).toBeUndefined();
  // The whole surface, of which "a" is no part any more.
  run(...prefix(1, 4, "b"));
  expect([heldChunk(map, "a"), heldChunk(map, "b")]).toEqual([undefined, 4]);
});

describe("distances of the surface on screen", () => {
  const events: StateEvent[] = [
    { type: "connection", state: "connected" },
    { type: "message", message: { type: "opened", volume: VOLUMES[0]!, step: 0, edit: OPENING, device: "none", capabilities: CAPABILITIES } },
    { type: "sent", surface: 0, at: 0 },
    { type: "message", message: { type: "done", trace: "00000000000000ab", surface: 0, generation: 1, statistics: statistics(100) } },
  ];
  const distances = { share: 0.98, upper: 1, farthest: 2 };
  const run = next;
  const done = run(NOTHING_KNOWN, ...events);
  const isDue = (state: ViewerState) => dueQuestions(state, ["annotate"]).some(({ question }) => question.type === "annotate");

  test("are asked for where colours show them, once", () => {
    expect(dueQuestions(done, ["curve", "distribution"]).map(({ question }) => question.type)).not.toContain("annotate");
    expect([isDue(done), awaitedDistances(done)]).toEqual([true, "measuring"]);
    const known = run(done, { type: "distances", surface: 0, generation: 1, distances });
    expect([isDue(known), measuredDistances(known), awaitedDistances(known)]).toEqual([false, distances, undefined]);
    expect(measuredDistances(run(known, { type: "connection", state: "waiting" }))).toEqual(distances);
  });

  test("are not known any more once an edit is sent, and too late for the next surface", () => {
    const known = run(done, { type: "distances", surface: 0, generation: 1, distances });
    const edited = run(known, { type: "sent", surface: 0, at: 1 });
    expect([measuredDistances(edited), awaitedDistances(edited)]).toEqual([undefined, "measuring"]);
    expect(measuredDistances(run(edited, { type: "distances", surface: 0, generation: 1, distances }))).toBeUndefined();
    const again = run(edited, { type: "message", message: { type: "done", trace: "00000000000000ab", surface: 0, generation: 2, statistics: statistics(100) } });
    expect([isDue(again), measuredDistances(again)]).toEqual([true, undefined]);
    expect(measuredDistances(run(again, { type: "distances", surface: 0, generation: 1, distances }))).toBeUndefined();
    expect(measuredDistances(run(again, { type: "distances", surface: 0, generation: 2, distances }))).toEqual(distances);
  });

  test("are those of the surface that has the colours of the look, whichever is selected", () => {
    const own = { ...DEFAULT_STYLE, color: "#e08a5b" };
    const surfaces = [{ number: 0, view: OPENING, style: DEFAULT_STYLE }, { number: 1, view: OPENING, style: own }];
    const both = run(done, { type: "arrange", surfaces }, { type: "select", surface: 1 });
    expect(dueErrors(both, surfaces).map(({ question }) => question)).toEqual([{ type: "annotate", surface: 0, annotation: "error-around" }]);
    expect(awaitedErrors(both, surfaces)).toBe("measuring");
    const known = run(both, { type: "distances", surface: 0, generation: 1, distances });
    expect([shownErrors(known, surfaces), awaitedErrors(known, surfaces), dueErrors(known, surfaces)]).toEqual([distances, undefined, []]);
    // An edit of the other one changes nothing here.
    expect(shownErrors(run(known, { type: "sent", surface: 1, at: 2 }), surfaces)).toEqual(distances);
    const none = surfaces.map((surface) => ({ ...surface, style: own }));
    expect([shownErrors(known, none), awaitedErrors(known, none), dueErrors(known, none)]).toEqual([undefined, undefined, []]);
  });

  test("are those of all surfaces that have the colours of the look, one asked after the other, in one scale", () => {
    const surfaces = [0, 1, 2].map((number) => ({ number, view: OPENING, style: { ...DEFAULT_STYLE, visible: number < 2 } }));
    const made = [
      { type: "arrange", surfaces },
      { type: "sent", surface: 1, at: 1 },
      { type: "message", message: { type: "done", trace: "00000000000000ab", surface: 1, generation: 2, statistics: statistics(100) } },
    ] as const;
    const asked = (state: ViewerState) => dueErrors(state, surfaces).map(({ question }) => question.surface);
    const all = run(done, ...made);
    expect(asked(all)).toEqual([0]);
    const one = run(all, { type: "distances", surface: 0, generation: 1, distances });
    expect([shownErrors(one, surfaces), awaitedErrors(one, surfaces), asked(one)]).toEqual([undefined, "measuring", [1]]);
    const farther = { ...distances, upper: 2 * distances.upper, farthest: distances.farthest / 2 };
    const both = run(one, { type: "distances", surface: 1, generation: 2, distances: farther });
    expect([shownErrors(both, surfaces), awaitedErrors(both, surfaces), asked(both)]).toEqual([{ ...distances, upper: farther.upper }, undefined, []]);
  });

  test("are not asked of a server that does not measure them", () => {
    const old = { ...done, questions: ["curve"] };
    expect([isDue(old), awaitedDistances(old)]).toEqual([false, "unknown"]);
    expect(awaitedDistances({ ...done, statistics: statistics(0) })).toBeUndefined();
  });
});
