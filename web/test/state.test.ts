import { describe, expect, test } from "vitest";
import type { ServerMessage } from "../src/protocol/types";
import type { StateEvent } from "../src/state/reduce";
import { firstCoarseFrames, showsFinal } from "../src/state/viewer";
import { NOTHING_KNOWN, run } from "./acting";
import { CAPABILITIES, OPENING, statistics, VOLUMES } from "./fixture";

const message = (message: ServerMessage): StateEvent => ({ type: "message", message });
const opened = (id: string) =>
  message({ type: "opened", volume: VOLUMES.find((v) => v.id === id)!, step: 0, edit: OPENING, device: "Fixture", capabilities: CAPABILITIES });
const prefix = (generation: number, level: number, colorField?: string) =>
  message({ type: "prefix", surface: 0, generation, level, kind: "cut", mesher: "dual", regions: 1, unchanged: 0, triangles: 1, ...(colorField !== undefined && { colorField }), final: level === 0 });
const done = (generation: number) => message({ type: "done", trace: "00000000000000ab", surface: 0, generation, statistics: statistics(100) });
const swap = (generation: number, level: number): StateEvent => ({ type: "swap", surface: 0, generation, level, final: level === 0 });
const frame = (at: number): StateEvent => ({ type: "frame", at });

const OPEN = run(NOTHING_KNOWN, { type: "connection", state: "connected" }, opened("ball"));

describe("one generation", () => {
  const sent = run(OPEN, { type: "sent", surface: 0, at: 1000 }, prefix(1, 3), { type: "chunk", bytes: 500 });

  test("works from the edit until it is done", () => {
    expect(run(OPEN, { type: "sent", surface: 0, at: 1000 }).working).toBe(true);
    expect(sent.working).toBe(true);
    expect(run(sent, done(1))).toMatchObject({ working: false, statistics: { triangles: 100 } });
  });

  test("counts bytes and times from the edit to its first and last frame", () => {
    const coarse = run(sent, swap(1, 3), frame(1040), frame(1050));
    expect(coarse.progress).toMatchObject({ generation: 1, bytes: 500, firstMs: 40, lastMs: undefined });
    const fine = run(coarse, prefix(1, 0), { type: "chunk", bytes: 700 }, done(1), swap(1, 0), frame(1200), frame(1900));
    expect(fine.progress).toMatchObject({ bytes: 1200, firstMs: 40, lastMs: 200 });
    expect(fine.bytesReceived).toBe(1200);
  });

  test("has one first frame, of a coarse prefix or of none", () => {
    const shown = run(sent, swap(1, 3));
    expect(firstCoarseFrames(shown, run(shown, frame(1040)))).toEqual([1]);
    const later = run(shown, frame(1040), swap(1, 2));
    expect(firstCoarseFrames(later, run(later, frame(1080)))).toEqual([]);
    const final = run(sent, swap(1, 0));
    expect(firstCoarseFrames(final, run(final, frame(1040)))).toEqual([]);
  });

  test("is not timed by frames of the one before", () => {
    const newer = run(sent, swap(1, 3), { type: "sent", surface: 0, at: 2000 }, prefix(2, 3), frame(2010));
    expect(newer.progress).toMatchObject({ generation: 2, startedAt: 2000, bytes: 0, firstMs: undefined });
    expect(newer.frameDue).toBe(false);
  });

  test("has the values of the field that its prefix names, whatever the view has meanwhile", () => {
    const edit = (colorField: string): StateEvent => ({ type: "edit", edit: { colorField }, gesture: undefined });
    const shown = run(sent, swap(1, 0), edit("height"), edit("depth"));
    expect(shown.shownField).toBe(null);
    const begun = run(shown, prefix(2, 3, "height"));
    expect(begun.shownField).toBe(null);
    expect(run(begun, swap(2, 3)).shownField).toBe("height");
    // It is shown after the next generation has begun.
    const next = run(begun, prefix(3, 3, "depth"), swap(2, 3));
    expect(next.shownField).toBe("height");
    expect(run(next, swap(3, 3)).shownField).toBe("depth");
    expect(run(next, swap(3, 3), prefix(4, 0), swap(4, 0)).shownField).toBe(null);
  });

  test("is final on screen when its level 0 is in a frame", () => {
    expect(showsFinal(run(sent, swap(1, 3), frame(1040)))).toBe(false);
    expect(showsFinal(run(sent, swap(1, 0)))).toBe(false);
    expect(showsFinal(run(sent, swap(1, 0), frame(1040)))).toBe(true);
  });
});

describe("the error of a surface", () => {
  const measured = (generation: number) =>
    message({ type: "measured", surface: 0, generation, error: { rms: 0.04, max: 0.3 }, regions: [] });
  const estimated = run(OPEN, prefix(1, 0), swap(1, 0), done(1));

  test("is an estimate until it is measured", () => {
    expect(estimated.statistics).toMatchObject({ error: null, estimatedError: { rms: 0.05 } });
    expect(run(estimated, measured(1)).statistics).toEqual({ ...statistics(100), error: { rms: 0.04, max: 0.3 } });
  });

  test("is not that of the surface before a better one", () => {
    const better = message({ type: "done", trace: "00000000000000ab", surface: 0, generation: 1, statistics: statistics(90) });
    const shown = run(estimated, frame(500));
    const coming = run(shown, prefix(1, 0), { type: "chunk", bytes: 300 });
    expect(coming).toMatchObject({ working: false, statistics: { triangles: 100 }, progress: { bytes: 300, lastMs: 500 } });
    const improved = run(coming, swap(1, 0), frame(900), better);
    expect(improved).toMatchObject({ working: false, statistics: { triangles: 90, error: null }, progress: { lastMs: 500 } });
    expect(run(improved, measured(1)).statistics?.error).toEqual({ rms: 0.04, max: 0.3 });
  });

  test("is not that of an earlier surface", () => {
    expect(run(estimated, prefix(2, 0), done(2), measured(1)).statistics?.error).toBeNull();
    expect(run(estimated, opened("ball"), measured(1)).statistics?.error).toBeNull();
    expect(run(OPEN, measured(1)).statistics).toBeUndefined();
  });
});

describe("opening", () => {
  const shown = run(OPEN, { type: "sent", surface: 0, at: 0 }, prefix(1, 0), swap(1, 0), frame(9), done(1));

  test("another volume forgets surface and statistics", () => {
    const state = run(shown, { type: "open", target: { volume: "ball-mirrored", step: 0 } });
    expect(state).toMatchObject({ opening: true, volume: { id: "ball" } });
    expect(run(state, opened("ball-mirrored"))).toMatchObject({
      opening: false,
      volume: { id: "ball-mirrored" },
      shown: undefined,
      statistics: undefined,
    });
  });

  test("another step keeps them until its own arrive", () => {
    expect(run(shown, opened("ball"))).toMatchObject({ shown: { level: 0 }, statistics: { triangles: 100 }, progress: undefined });
  });

  test("sorts the points of the transfer function", () => {
    const points = [...OPENING.transferFunction.points].reverse();
    const state = run(NOTHING_KNOWN, message({ type: "opened", volume: VOLUMES[0]!, step: 0, edit: { ...OPENING, transferFunction: { points } }, device: "", capabilities: CAPABILITIES }));
    expect(state.view).toEqual(OPENING);
  });

  test("states its share until the volume is open", () => {
    const open: StateEvent = { type: "open", target: { volume: "ball-mirrored", step: 0 } };
    const reading = run(shown, open, message({ type: "opening", bytes: 3, totalBytes: 12 }));
    expect(reading.openedShare).toBe(0.25);
    expect(run(reading, opened("ball-mirrored")).openedShare).toBeUndefined();
    expect(run(reading, open).openedShare).toBeUndefined();
    const preparing = run(shown, open, message({ type: "opening", bytes: 0, totalBytes: 0, device: { done: 12, of: 34 } }));
    expect(preparing.preparing).toEqual({ done: 12, of: 34 });
    expect(run(preparing, message({ type: "opening", bytes: 3, totalBytes: 12 })).preparing).toBeUndefined();
    expect(run(preparing, opened("ball-mirrored")).preparing).toBeUndefined();
    const failed = message({ type: "error", code: "unreadable-volume", message: "cut off", open: true });
    expect(run(reading, failed).openedShare).toBeUndefined();
  });

  test("that fails ends with the error", () => {
    const error = message({ type: "error", code: "unknown-volume", message: "no such volume", open: true });
    expect(run(OPEN, { type: "open", target: { volume: "x", step: 0 } }, error)).toMatchObject({ opening: false, working: false });
  });
});

test("a lost connection ends the work, not the surface", () => {
  const state = run(OPEN, { type: "sent", surface: 0, at: 0 }, prefix(1, 3), swap(1, 3), { type: "connection", state: "waiting" });
  expect(state).toMatchObject({ working: false, connection: "waiting", shown: { level: 3 } });
});

test("other values take the place of those before, where there are any", () => {
  const event: StateEvent = { type: "edit", edit: { alpha: 1 } };
  expect(run(NOTHING_KNOWN, event).state).toBe(NOTHING_KNOWN.state);
  expect(run(OPEN, event).view).toEqual({ ...OPENING, alpha: 1 });
});

test("a refusal stays until the next edit", () => {
  const refused = run(OPEN, message({ type: "error", code: "over-budget", message: "too few", open: true, suggestedTriangles: 9 }));
  expect(refused.refusal).toMatchObject({ code: "over-budget", suggestedTriangles: 9 });
  expect(run(refused, { type: "sent", surface: 0, at: 0 }).refusal).toBeUndefined();
});
