import { expect, test } from "vitest";
import type { SurfaceRenderer } from "../src/scene/renderer";
import { isEqual } from "../src/protocol/equal";
import { askedView } from "../src/state/comparing";
import { FIRST_STATE } from "../src/state/state";
import { Comparison } from "../src/wiring/comparison";
import { OPENING } from "./fixture";

/** A comparison over a scene that notes what it is asked for. */
function comparisonOf() {
  const calls: string[] = [];
  /** Budgets that the server was asked for. */
  const sent: unknown[] = [];
  const states: (string | undefined)[] = [];
  const scene = {
    regionCount: 1,
    levelTriangles: [10, 5],
    annotations: { swipe: { value: undefined } },
    keep: () => calls.push("keep"),
    release: () => calls.push("release"),
    swipe: (share: number, texts: { kept: string; now: string }) => calls.push(`${share} ${texts.kept} | ${texts.now}`),
  };
  const store = { state: FIRST_STATE };
  const comparison = new Comparison(scene as unknown as SurfaceRenderer, store, (comparing) => {
    const before = askedView(OPENING, store.state.comparing);
    store.state = { ...store.state, comparing };
    states.push(comparing?.isWaiting === true ? "waiting" : comparing?.kind);
    const asked = askedView(OPENING, comparing);
    if (!isEqual(asked, before)) sent.push(asked);
  });
  return { comparison, scene, calls, sent, states };
}

test("the full surface is fetched, kept, and the values in force come back", () => {
  const { comparison, scene, calls, sent, states } = comparisonOf();
  comparison.start("full");
  expect(sent).toEqual([{ ...OPENING, error: undefined, triangles: { share: 1 }, detail: "uniform" }]);
  comparison.advance(false);
  expect([calls, states]).toEqual([[], ["waiting"]]);
  scene.levelTriangles = [1200, 0];
  comparison.advance(true);
  expect(sent[1]).toEqual(OPENING);
  scene.levelTriangles = [200, 100];
  comparison.advance(true);
  comparison.advance(true);
  expect(calls.slice(-1)).toEqual(["0.5 full · 1,200 triangles | decimated · 300 triangles"]);
  expect(calls.filter((call) => call === "keep").length).toBe(1);
  comparison.end();
  expect([calls.at(-1), states]).toEqual(["release", ["waiting", "full", undefined]]);
});

test("stopped while the full surface is on its way, the values in force come back too", () => {
  const { comparison, sent, calls } = comparisonOf();
  comparison.start("full");
  comparison.end();
  comparison.end();
  expect(sent.length).toBe(2);
  expect(sent[1]).toEqual(OPENING);
  comparison.advance(true);
  expect(calls).toEqual(["release"]);
});

test("what is shown is kept at once to compare edits with it, and asks for nothing", () => {
  const { comparison, calls, sent } = comparisonOf();
  comparison.start("edit");
  expect(calls).toEqual(["keep", "0.5 before · 15 triangles | now · 15 triangles"]);
  expect(sent).toEqual([]);
});

test("without importance the server is asked for as many triangles, and for the values in force at the end", () => {
  const { comparison, calls, sent, states } = comparisonOf();
  comparison.start("importance");
  const points = OPENING.transferFunction.points.map((point) => ({ ...point, importance: 0 }));
  expect(sent).toEqual([{ ...OPENING, error: undefined, triangles: 15, transferFunction: { points }, interest: [] }]);
  expect(calls).toEqual(["keep", "0.5 with importance · 15 triangles | without · 15 triangles"]);
  comparison.advance(true);
  comparison.end();
  expect(sent[1]).toEqual(OPENING);
  expect([calls.at(-1), states]).toEqual(["release", ["importance", undefined]]);
});
