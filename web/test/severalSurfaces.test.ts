import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket } from "ws";
import type { ServerMessage, View } from "../src/protocol/types";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { dueQuestions } from "../src/state/answers";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { aloneView, budgetEdit, sharedStatistics, sharerCount } from "../src/state/sharedBudget";
import { complete } from "../src/protocol/view";
import type { StateEvent } from "../src/state/reduce";
import { isWorking, showsFinal } from "../src/state/viewer";
import { furtherIsovalue } from "../src/ui/plots/landmarks";
import { allWords } from "../src/ui/cards/detail";
import { rowText } from "../src/ui/cards/surfaceRows";
import { inkOn, placeOf, surfaceName } from "../src/ui/surfaceNames";
import { errorText, summaryOf } from "../src/ui/words";
import { ActingPage, ActingStore, run, type Known } from "./acting";
import { CAPABILITIES, FixtureServer, OPENING, statistics, VOLUMES, voxels } from "./fixture";

const opened = (id: string, surfaces = 4): Parameters<ActingStore["open"]>[0] => ({
  type: "opened",
  volume: VOLUMES.find((v) => v.id === id)!,
  step: 0,
  edit: OPENING,
  device: "Fixture",
  capabilities: { ...CAPABILITIES, surfaces },
});

/** A store in which a volume was opened. */
const open = (store: ActingStore, id: string, wish?: Parameters<ActingStore["open"]>[1], surfaces = 4) => store.open(opened(id, surfaces), wish);

const isos = (store: ActingStore) => store.surfaces.map(({ number, view }) => [number, view.iso]);

describe("the store's surfaces", () => {
  test("are added, edited and removed, and each is one step of the history", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.edit({ alpha: 0.3 });
    store.addSurface(5);
    expect([isos(store), store.viewer.selected]).toEqual([[[0, 0], [1, 5]], 1]);
    expect(store.view).toMatchObject({ iso: 5, alpha: 0.3 });
    store.edit({ iso: 7 });
    store.select(0);
    store.edit({ alpha: 1 });
    store.removeSurface(1);
    expect([isos(store), store.surfaces[0]?.view.alpha]).toEqual([[[0, 0]], 1]);
    const steps: unknown[] = [];
    while (store.canUndo) {
      store.undo();
      steps.push([isos(store), store.viewer.selected, store.surfaces[0]?.view.alpha]);
    }
    expect(steps).toEqual([
      [[[0, 0], [1, 7]], 0, 1],
      [[[0, 0], [1, 7]], 0, 0.3],
      [[[0, 0], [1, 5]], 1, 0.3],
      [[[0, 0]], 0, 0.3],
      [[[0, 0]], 0, 0.6],
    ]);
    while (store.canRedo) store.redo();
    expect(isos(store)).toEqual([[0, 0]]);
  });

  test("selecting another one is no step, and one that is gone is not selected", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.addSurface(5);
    store.select(0);
    store.select(3);
    expect(store.viewer.selected).toBe(0);
    store.undo();
    expect([isos(store), store.canUndo]).toEqual([[[0, 0]], false]);
    store.redo();
    expect(isos(store)).toEqual([[0, 0], [1, 5]]);
  });

  test("the one around lets the other be seen, each has a colour of its own, and undo takes it back", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.addSurface(5);
    store.addSurface(-5);
    expect(store.surfaces.map(({ style }) => style.opacity)).toEqual([0.35, 1, 0.35]);
    const colors = store.surfaces.map(({ style }) => style.color);
    expect([colors[0], new Set(colors).size]).toEqual([undefined, 3]);
    store.undo();
    store.undo();
    expect(store.surfaces.map(({ style }) => style)).toEqual([{ visible: true, opacity: 1, color: undefined }]);
  });

  test("are one or more, and no more than the server allows", () => {
    const store = new ActingStore();
    open(store, "ball", undefined, 2);
    store.removeSurface(0);
    store.addSurface(1);
    store.addSurface(2);
    expect(isos(store)).toEqual([[0, 0], [1, 1]]);
    store.removeSurface(0);
    // Its number is free again.
    store.addSurface(3);
    expect([isos(store), store.viewer.selected]).toEqual([[[1, 1], [0, 3]], 0]);
    // Connected to a server with less.
    open(store, "ball", undefined, 1);
    expect([isos(store), store.viewer.selected]).toEqual([[[0, 1]], 0]);
    store.undo();
    expect(isos(store)).toEqual([[0, 1]]);
  });

  test("share the budget, and nothing else", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.addSurface(5);
    store.edit({ triangles: 900 });
    expect(store.surfaces.map(({ view }) => [view.triangles, view.error])).toEqual([[900, "1px"], [900, undefined]]);
    store.edit({ beta: 0.1 });
    expect(store.surfaces.map(({ view }) => [view.triangles, view.beta])).toEqual([[900, undefined], [undefined, 0.1]]);
    store.select(0);
    store.edit({ triangles: { share: 0.5 } });
    expect(store.surfaces[1]?.view).toMatchObject({ triangles: undefined, beta: 0.1 });
  });

  test("are kept by volume, with history and selection", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.addSurface(5);
    store.leave(undefined);
    open(store, "ball-mirrored");
    expect([isos(store), store.viewer.known.size]).toEqual([[[0, 0]], 1]);
    store.leave(undefined);
    open(store, "ball");
    expect([isos(store), store.viewer.selected, store.canUndo]).toEqual([[[0, 0], [1, 5]], 1, true]);
    // Another step, or a new connection.
    open(store, "ball");
    expect([isos(store), store.viewer.selected]).toEqual([[[0, 0], [1, 5]], 1]);
  });
});

describe("a link of several surfaces", () => {
  const surface = (number: number, view: Partial<View>, style = {}) => ({ number, view: { ...OPENING, ...view }, style: { visible: true, opacity: 1, color: undefined, ...style } });
  const state = { volume: "ball", step: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined };
  const surfaces = [
    surface(2, { iso: 1.5, alpha: 0.25 }, { opacity: 0.35 }),
    surface(0, { iso: -4, ...complete({ beta: 0.1 }) }, { color: "#e08a5b", visible: false }),
    surface(1, { iso: 9, feature: "none", interest: [{ sphere: { center: [1, 2, 3] as const, radius: 4 }, importance: 0.5 }] }),
  ];

  test("brings all back", () => {
    const hash = encodeLink({ ...state, surfaces, selected: 0 });
    expect(hash).toBe(
      "v=1&volume=ball&iso=1.5&alpha=0.25&opacity=0.35&s2.iso=-4&s2.beta=0.1&s2.tint=e08a5b&s2.hidden=1" +
        "&s3.iso=9&s3.feature=none&s3.roi=1,2,3,4,0.5&surface=2",
    );
    const store = new ActingStore();
    open(store, "ball", decodeLink(hash));
    expect(store.surfaces).toEqual(surfaces.map((of, number) => ({ ...of, number })));
    expect([store.viewer.selected, store.canUndo]).toEqual([1, false]);
    const link = decodeLink(hash);
    if (link === undefined) throw new Error("no link");
    store.select(0);
    store.removeSurface(2);
    store.replace(link);
    expect([store.surfaces.length, store.viewer.selected]).toEqual([3, 1]);
    store.undo();
    expect(store.surfaces.length).toBe(2);
  });

  test("of one surface is as before, and has what is beyond four left out", () => {
    expect(encodeLink({ ...state, surfaces: [surface(3, {})], selected: 3 })).toBe("v=1&volume=ball&iso=0");
    expect(decodeLink("v=1&volume=ball&iso=0&s3.iso=4")?.surfaces).toHaveLength(1);
    expect(decodeLink("v=1&volume=ball&iso=0&s2.iso=4&s3.iso=4&s4.iso=4&s5.iso=4")?.surfaces).toHaveLength(4);
  });

  test("that names different budgets has the first one's", () => {
    const store = new ActingStore();
    open(store, "ball", decodeLink("volume=ball&beta=0.1&s2.triangles=500&s3.share=0.1"));
    expect(store.surfaces.map(({ view }) => view.triangles)).toEqual([undefined, 500, 500]);
  });

  test("that is broken says where", () => {
    for (const [hash, wrong] of [
      ["s2.iso=high", "“s2.iso” is \"high\", expected a number"],
      ["s2.iso=1&s2.tint=red", "“s2.tint” has the colour \"red\""],
      ["s2.iso=1&s2.opacity=-0.1", "“s2.opacity” is -0.1, expected a number from 0 to 1"],
      ["opacity=2", "“opacity” is 2"],
      ["s2.hidden=yes", "“s2.hidden” is \"yes\", expected 0 or 1"],
      ["s2.tf=0,1,zz", "“s2.tf” has the colour"],
      ["s2.roi=1,2", "“s2.roi” has 2 numbers"],
    ] as const) {
      expect(() => decodeLink(`#volume=a&${hash}`), hash).toThrow(wrong);
    }
  });

  test("keeps as many as the server shows", () => {
    const store = new ActingStore();
    open(store, "ball", decodeLink(encodeLink({ ...state, surfaces, selected: 1 })), 1);
    expect([isos(store), store.viewer.selected]).toEqual([[[0, 1.5]], 0]);
  });
});

describe("what is known of surfaces", () => {
  const message = (message: ServerMessage): StateEvent => ({ type: "message", message });
  const of = (surface: number, generation: number) => ({ surface, generation });
  const prefix = (surface: number, generation: number, final = true) =>
    message({ type: "prefix", ...of(surface, generation), level: 0, kind: "cut", mesher: "dual", regions: 1, unchanged: 0, triangles: 1, final });
  const done = (surface: number, generation: number, triangles = 100) => message({ type: "done", trace: "00000000000000ab", ...of(surface, generation), statistics: statistics(triangles) });
  const swap = (surface: number, generation: number, final = true): StateEvent => ({ type: "swap", ...of(surface, generation), level: 0, final });

  /** Two surfaces that are done; 1 is selected. */
  function two(): Known {
    const store = new ActingStore();
    store.dispatch({ type: "connection", state: "connected" });
    open(store, "ball");
    store.addSurface(5);
    const sent: StateEvent[] = [{ type: "sent", surface: 0, at: 0 }, { type: "sent", surface: 1, at: 10 }];
    return run({ ...store.viewer, state: store.state }, ...sent, prefix(0, 1), { type: "chunk", bytes: 70 }, done(0, 1), swap(0, 1), prefix(1, 2), { type: "chunk", bytes: 30 }, done(1, 2, 300), swap(1, 2), { type: "frame", at: 50 });
  }

  test("is told apart by their numbers", () => {
    const state = two();
    expect(state).toMatchObject({ selected: 1, statistics: { triangles: 300 }, finished: 2, progress: { bytes: 30, lastMs: 40 } });
    expect(state.known.get(0)).toMatchObject({ statistics: { triangles: 100 }, finished: 1, progress: { bytes: 70 } });
    expect([state.bytesReceived, isWorking(state), showsFinal(state)]).toEqual([100, false, true]);
    const again = run(state, { type: "sent", surface: 0, at: 60 }, prefix(0, 3, false));
    expect([again.working, isWorking(again), showsFinal(run(again, swap(0, 3, false)))]).toEqual([false, true, false]);
    expect(run(again, done(0, 3, 50)).statistics?.triangles).toBe(300);
  });

  test("is that of the selected one, with its own questions and answers", () => {
    const state = two();
    expect(dueQuestions(state, ["curve", "distribution"]).map(({ question }) => [question.type, question.surface])).toEqual([["curve", 1], ["distribution", 1]]);
    const curve = message({ type: "curve", ...of(1, 2), kind: "tree", byError: true, points: [] });
    const known = run(state, curve);
    expect(dueQuestions(known, ["curve", "distribution"]).map(({ question }) => question.type)).toEqual(["distribution"]);
    const other = run(known, { type: "select", surface: 0 });
    expect([other.answers, other.statistics?.triangles]).toEqual([{}, 100]);
    expect(dueQuestions(other, ["curve", "distribution"]).map(({ question }) => question.surface)).toEqual([0, 0]);
    // An answer about one that is not selected any more is kept for when it is again.
    expect(run(other, message({ type: "distribution", ...of(1, 2), kind: "tree", bins: [1], coarse: [0], coarseShare: 0 })).known.get(1)?.answers.distribution).toBeDefined();
  });

  test("of a surface that was removed comes nothing, and one made anew begins anew", () => {
    const state = two();
    const one = run(state, { type: "remove", surface: 1 });
    expect(run(one, done(1, 2, 7), swap(1, 2), prefix(1, 2), message({ type: "removed", surface: 1 }))).toMatchObject({ known: { size: 1 }, statistics: { triangles: 100 } });
    const back = run(one, { type: "undo" }, { type: "sent", surface: 1, at: 99 });
    // What the server said before it knew.
    const late = run(back, done(1, 2, 7));
    expect(run(late, message({ type: "removed", surface: 1 }))).toMatchObject({ statistics: undefined, working: true, view: { ...OPENING, iso: 5 } });
  });

  test("fails for one alone, or for the last edit", () => {
    const working = run(two(), { type: "sent", surface: 0, at: 1 }, { type: "sent", surface: 1, at: 1 });
    const error = { type: "error", code: "over-budget", message: "too few", open: true } as const;
    const failed = run(working, message({ ...error, surface: 0 }));
    expect([failed.refusal, failed.working, failed.known.get(0)?.refusal?.code]).toEqual([undefined, true, "over-budget"]);
    expect(isWorking(run(working, message(error)))).toBe(false);
  });

  test("the top line is about all of them", () => {
    expect(summaryOf(two(), 400, false, voxels(1)).parts).toEqual(["2 surfaces", "400 of 1,600 triangles (25 %)", "error ≈ 0.05 voxels (RMS)", "0.04 s"]);
    const measured = run(two(), message({ type: "measured", ...of(0, 1), error: { rms: 0.2, max: 1 }, regions: [] }), message({ type: "measured", ...of(1, 2), error: { rms: 0, max: 0 }, regions: [] }));
    expect(summaryOf(measured, 400, false, voxels(1)).parts[2]).toBe("error 0.1 voxels (RMS)");
    const store = new ActingStore();
    open(store, "ball");
    store.addSurface(2);
    expect([surfaceName(store.surfaces, 1), placeOf(store.surfaces, 0), surfaceName([], 0)]).toEqual(["surface 2", 1, ""]);
    expect(errorText({ type: "error", code: "over-budget", message: "too few", open: true, surface: 1 }, store.surfaces)).toBe("Surface 2: too few");
  });

  test("a row says what there is of a surface", () => {
    const shown = { generation: 1, level: 0, final: true };
    const refusal = { type: "error", code: "over-budget", message: "too few", open: true } as const;
    expect([rowText({ shown, refusal: undefined }, 1234), rowText({ shown, refusal: undefined }, 0), rowText({ shown, refusal }, 9), rowText(undefined, 0)]).toEqual(["1,234 △", "no surface", "refused", "0 △"]);
  });

  test("a budget's triangles are those of all that share it, and the mesh of one has its part", () => {
    const all = (edit: Partial<View>) => {
      const surfaces = [0, 1].map((number) => ({ number, view: { ...OPENING, ...edit }, style: DEFAULT_STYLE }));
      return run(two(), { type: "arrange", surfaces });
    };
    expect([1, 2, 4].map(allWords)).toEqual(["all", "both", "all 4"]);
    expect([sharerCount(two()), sharedStatistics(two())]).toMatchObject([2, { triangles: 400, fullTriangles: 1600 }]);
    expect(aloneView(all(complete({ triangles: 800 })))?.triangles).toBe(600);
    expect(aloneView(all(complete({ triangles: { share: 0.5, max: 400 } })))?.triangles).toEqual({ share: 0.5, max: 300 });
    expect(aloneView(all(complete({ triangles: { share: 0.5 } })))?.triangles).toEqual({ share: 0.5 });
    expect(budgetEdit(all(complete({ triangles: 800 })), { share: 0.5 })).toEqual({ triangles: 800 });
    expect(budgetEdit(all(complete({ beta: 0.1 })), { share: 0.5 })).toEqual({ triangles: { share: 0.5 } });
    const alone = all(complete({ beta: 0.1 }));
    expect([sharerCount(alone), sharedStatistics(alone)?.triangles, aloneView(alone)?.beta]).toEqual([1, 300, 0.1]);
  });
});

describe("the stream follows the store", () => {
  let server: FixtureServer;
  let page: ActingPage;
  /** Surfaces that are gone. */
  const removed: number[] = [];

  beforeEach(async () => {
    vi.stubGlobal("WebSocket", WebSocket);
    server = new FixtureServer();
    server.paceMs = 1;
    const port = await server.listen();
    removed.length = 0;
    page = new ActingPage(`ws://127.0.0.1:${port}/api/v1/stream`, {
      onBroken: (reason) => expect.fail(reason),
      onMessage: (message) => {
        if (message.type === "error") expect.fail(message.message);
        if (message.type === "removed") removed.push(message.surface);
      },
    });
    page.open("ball", 0);
    page.client.start();
    await vi.waitFor(() => expect(page.store.viewer.statistics).toBeDefined(), 10_000);
    server.received.length = 0;
  });

  afterEach(async () => {
    page.client.stop();
    await server.close();
    vi.unstubAllGlobals();
  });

  const change = (act: (now: ActingStore) => void) => page.change(act);
  const sent = (count: number) => vi.waitFor(() => expect(server.received.length).toBe(count), 10_000);

  test("adding, editing, colouring and removing", async () => {
    change((now) => now.addSurface(5));
    await sent(1);
    expect(server.received[0]).toMatchObject({ type: "edit", surface: 1, iso: 5, triangles: OPENING.triangles, error: "1px" });
    change((now) => now.changeStyle(1, { opacity: 0.5, color: "#123456" }));
    change((now) => now.edit({ transferFunction: { points: OPENING.transferFunction.points.map((point) => ({ ...point, color: "#123456" })) } }));
    change((now) => now.edit({ triangles: 900 }));
    await sent(2);
    // The other surface's budget is the same one: nothing is said of it.
    expect(server.received[1]).toEqual({ type: "edit", surface: 1, triangles: 900 });
    expect(page.store.surfaces[0]?.view.triangles).toBe(900);
    change((now) => now.removeSurface(1));
    await sent(3);
    expect(server.received[2]).toEqual({ type: "remove", surface: 1 });
    // What is on screen goes when the server says so.
    await vi.waitFor(() => expect(removed).toEqual([1]), 10_000);
    change((now) => now.undo());
    await sent(4);
    expect(server.received[3]).toMatchObject({ type: "edit", surface: 1, iso: 5, transferFunction: { points: [{ color: "#123456" }, {}, {}, {}] } });
  });

  test("a surface that the server never saw is taken back in silence", async () => {
    change((now) => now.edit({ alpha: 0.1 }));
    // Within the interval of edits: nothing of it was sent.
    change((now) => now.addSurface(5));
    change((now) => now.undo());
    change((now) => now.edit({ alpha: 0.2 }));
    await sent(2);
    expect(server.received[1]).toEqual({ type: "edit", alpha: 0.2 });
  });

  test("another step and a new connection bring all of them, without the one that was removed meanwhile", async () => {
    change((now) => now.addSurface(5));
    change((now) => now.addSurface(-5));
    await sent(2);
    change((now) => now.removeSurface(0));
    await sent(3);
    server.received.length = 0;
    page.open("ball", 3);
    // The server does not know it any more, and the picture has it still.
    change((now) => now.removeSurface(2));
    expect(removed).toContain(2);
    await sent(3);
    expect(server.received.map((message) => [message.type, (message as { surface?: number }).surface])).toEqual([["open", undefined], ["remove", 0], ["edit", 1]]);
  });

  test("another volume has its own, and what was kept comes back with it", async () => {
    change((now) => now.addSurface(5));
    change((now) => now.removeSurface(0));
    await sent(2);
    page.open("ball-mirrored", 0);
    await sent(4);
    expect(server.received.slice(2)).toEqual([{ type: "open", volume: "ball-mirrored", step: 0, codings: ["predictive", "values"] }, { type: "edit" }]);
    page.open("ball", 0);
    await sent(7);
    expect(server.received.slice(5)).toMatchObject([{ type: "remove", surface: 0 }, { type: "edit", surface: 1, iso: 5 }]);
  });
});

describe("a further isovalue", () => {
  const bell = (at: number, height: number) => (bin: number) => height * Math.exp(-(((bin - at) / 8) ** 2));
  const counts = Array.from({ length: 256 }, (_, bin) => Math.round(bell(40, 9000)(bin) + bell(150, 4000)(bin)));
  const field = { ...VOLUMES[0]!.fields[0]!, histogram: { min: 0, max: 255, counts }, openingIso: { iso: 200, reason: "bone", explanation: "bone" } } as const;

  test("is a threshold where no surface is, else the middle of the widest gap", () => {
    expect(furtherIsovalue(field, undefined, [90])).toBe(200);
    const otsu = furtherIsovalue(field, undefined, [200]);
    expect([otsu > 50, otsu < 150]).toEqual([true, true]);
    const middle = furtherIsovalue(field, undefined, [200, otsu]);
    expect(Math.min(Math.abs(middle - otsu), Math.abs(middle - 200))).toBeGreaterThan(15);
  });

  test("is a value, also where there is one alone", () => {
    expect(furtherIsovalue({ ...field, histogram: { min: 3, max: 3, counts: [9] } }, undefined, [3])).toBe(3);
  });
});

test("numbers are read on every colour", () => {
  expect(["#ffffff", "#e3c12f", "#2a7a64", "#000080"].map(inkOn)).toEqual(["#000000", "#000000", "#ffffff", "#ffffff"]);
});
