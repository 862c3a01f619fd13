import { describe, expect, test } from "vitest";
import type { Probed } from "../src/protocol/types";
import { DEFAULT_LOOK } from "../src/state/look";
import { curvesOf, placesOfSteps, timeCurvesCsv, type TimeCurves } from "../src/state/timeCurves";
import { NOTHING_KNOWN } from "./acting";
import { TimeMeasuring } from "../src/wiring/timeMeasuring";
import { OPENING, statistics, VOLUMES } from "./fixture";

const VOLUME = { ...VOLUMES[0]!, steps: 3 };
const POINT = [1, 2, 3] as const;

/** A store of three steps, and the requests made for it. */
function measuring(fails = false) {
  const store = {
    look: { ...DEFAULT_LOOK, measures: [{ kind: "reading" as const, points: [POINT] as const, values: [] }] },
    step: 1,
    view: OPENING,
    viewer: { ...NOTHING_KNOWN, volume: VOLUME, target: { volume: VOLUME.id, step: 1 }, statistics: statistics(9) },
  };
  const [went, shown, failed]: [number[], TimeCurves[], string[]] = [[], [], []];
  const machine = new TimeMeasuring(store, {
    isShown: () => true,
    go: (step) => {
      went.push(step);
      store.step = step;
      store.viewer = { ...store.viewer, target: { volume: VOLUME.id, step }, statistics: statistics(step === 2 ? 0 : 9) };
    },
    back: () => went.push(-1),
    sum: () => (fails ? Promise.reject(new Error("out of memory")) : Promise.resolve({ area: 10 + store.step, volume: 5, borderEdges: store.step })),
    probe: () => Promise.resolve({ values: [{ field: OPENING.field, value: 100 * store.step }] } as unknown as Probed),
    show: (curves) => shown.push(curves),
    fail: (reason) => failed.push(reason),
  });
  return { machine, store, went, shown, failed, ended: () => expect.poll(() => shown.at(-1)?.isRunning).toBe(false) };
}

describe("measuring over time", () => {
  test("goes through all steps once and back, and measures in each", async () => {
    const { machine, went, shown, failed, ended } = measuring();
    machine.start();
    await ended();
    expect(went).toEqual([0, 1, 2, -1]);
    expect(shown.at(-1)?.rows).toEqual([
      { step: 0, sums: { area: 10, volume: 5, borderEdges: 0 }, values: [0] },
      { step: 1, sums: { area: 11, volume: undefined, borderEdges: 1 }, values: [100] },
      { step: 2, sums: undefined, values: [200] },
    ]);
    expect(failed).toEqual([]);
  });

  test("ends where the surface is changed, and says so", async () => {
    const { machine, store, shown, failed, ended } = measuring();
    machine.start();
    store.view = { ...OPENING, iso: OPENING.iso + 1 };
    await ended();
    expect(failed).toEqual(["Measuring over time has ended: the surface or the time step was changed"]);
    expect(shown.at(-1)?.rows.length).toBeLessThan(3);
  });

  test("says why it cannot go on", async () => {
    const { machine, failed, ended } = measuring(true);
    machine.start();
    await ended();
    expect(failed).toEqual(["Measuring over time has ended at step 1: out of memory"]);
  });

  test("keeps what it has when it is stopped", async () => {
    const { machine, went, shown } = measuring();
    machine.start();
    machine.stop();
    await Promise.resolve();
    expect(shown.at(-1)?.isRunning).toBe(false);
    expect(went).toEqual([0, -1]);
  });
});

const CURVES: TimeCurves = {
  volume: VOLUME.id,
  of: OPENING,
  field: "depth",
  count: 3,
  points: [POINT],
  rows: [
    { step: 0, sums: { area: 10, volume: 5, borderEdges: 0 }, values: [1.5] },
    { step: 1, sums: undefined, values: [undefined] },
  ],
  isRunning: false,
};

test("a step without a surface has no area, and a point outside no value", () => {
  const titles = curvesOf(CURVES, VOLUME).map(({ title, values }) => [title.replace(/,.*/, ""), values]);
  expect(titles).toEqual([["Area", [10, 0]], ["Volume", [5, 0]], ["depth at the point", [1.5, undefined]]]);
});

test("steps lie where their times are", () => {
  const times = { label: "", labels: null, unit: "s", calendar: null, start: 0, spacing: null, values: [0, 1, 10] };
  expect(placesOfSteps(CURVES, times)).toEqual([0, 0.1]);
  expect(placesOfSteps(CURVES, null)).toEqual([0, 0.5]);
});

test("a table has a line for each step, with units and times", () => {
  const csv = timeCurvesCsv(CURVES, VOLUME, (step) => (step === 0 ? "2020-01-01, noon" : undefined)).split("\r\n");
  expect(csv[0]).toMatch(/^volume,step,time,area \(.*²\),volume \(.*³\),border edges,depth at point 1 \(1 2 3\)$/);
  expect(csv[1]).toBe(`${VOLUME.id},1,"2020-01-01, noon",10,5,0,1.5`);
  expect(csv[2]).toBe(`${VOLUME.id},2,,0,0,0,`);
});
