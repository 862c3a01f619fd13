import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket } from "ws";
import type { Edit, Probed, Question, ServerMessage, Vec3 } from "../src/protocol/types";
import { Questions } from "../src/questions/questions";
import type { Place } from "../src/questions/prober";
import { dueQuestions, isAboutQuestion } from "../src/state/answers";
import { MAX_REGIONS, paint, type Interest } from "../src/state/interest";
import { probeRows } from "../src/ui/probeReadout";
import { shareWords } from "../src/ui/cards/detail";
import { curveWords } from "../src/ui/plots/curvePlot";
import { corrected, correctionOf, errorAt, fineSide, linePath, meetsAxisText, NO_CORRECTION, toX, toY, trianglesFor } from "../src/ui/plots/errorCurve";
import { ActingPage } from "./acting";
import { CURVE, FixtureServer, statistics, VOLUMES, voxels } from "./fixture";

class Canvas {
  readonly tabIndex = 0;
}

/** Hands events to those that listen, as an element does whose canvas they hit. */
class Viewport {
  private readonly listeners = new Map<string, (event: object) => void>();
  getBoundingClientRect = () => ({ left: 0, top: 0, width: 100, height: 80 });
  addEventListener(type: string, listener: (event: object) => void): void {
    this.listeners.set(type, listener);
  }
  send(type: string, event: object): void {
    this.listeners.get(type)?.({ target: new Canvas(), ...event });
  }
}

/** A page without a picture: what is received is on screen at once. */
class Page {
  readonly errors: string[] = [];
  readonly said: string[] = [];
  readonly probes: (Probed | undefined)[] = [];
  readonly picked: number[] = [];
  readonly pointed: Vec3[] = [];
  /** Position of the surface under the pointer. */
  under: Vec3 | undefined = [1, 2, 3];
  underSurface = 0;
  readonly page: ActingPage;
  readonly questions: Questions;

  /** Places at which the scene was asked for the surface under them. */
  readonly looked: number[] = [];
  private readonly viewport = new Viewport();

  constructor(port: number) {
    this.page = new ActingPage(`ws://127.0.0.1:${port}/api/v1/stream`, {
      onState: (state) => this.store.dispatch({ type: "connection", state }),
      onBroken: (reason) => this.errors.push(reason),
      onEditSent: (surface) => {
        this.store.dispatch({ type: "sent", surface, at: 0 });
        this.questions.edited();
      },
      onMessage: (message) => this.receive(message),
    });
    this.questions = new Questions(this.store, (question) => this.stream.ask(question), (place) => this.pick(place), {
      showProbe: (probed) => this.probes.push(probed),
      addPoint: (blended) => this.picked.push(blended),
      point: (position) => this.pointed.push(position),
      act: (event) => {
        this.page.change((store) => store.dispatch(event));
        this.questions.follow();
      },
      isStill: () => true,
      say: (text) => this.said.push(text),
    });
    this.questions.listen(this.viewport as unknown as HTMLElement);
  }

  get store() {
    return this.page.store;
  }

  get stream() {
    return this.page.client;
  }

  /** A place where the scene takes longer. */
  slowAt: number | undefined;

  private async pick([x]: Place): Promise<{ position: Vec3; surface: number } | undefined> {
    this.looked.push(x);
    for (let turn = 0; x === this.slowAt && turn < 50; turn += 1) await Promise.resolve();
    return this.under && { position: this.under, surface: this.underSurface };
  }

  edit(edit: Edit): void {
    this.page.edit(edit);
    this.questions.follow();
  }

  hover = ([clientX, clientY]: readonly [number, number]) => this.viewport.send("pointermove", { clientX, clientY, buttons: 0, pointerType: "mouse" });
  leave = () => this.viewport.send("pointerleave", {});
  press = (key: string) => this.viewport.send("keydown", { key });
  click([clientX, clientY]: readonly [number, number]): void {
    this.viewport.send("pointerdown", { clientX, clientY, button: 0, isPrimary: true });
    this.viewport.send("pointerup", { clientX, clientY });
  }

  private receive(message: ServerMessage): void {
    if (message.type === "committed") this.store.dispatch({ ...message, type: "swap" });
    if (!this.questions.received(message) && message.type === "error") this.errors.push(message.message);
    this.questions.follow();
  }
}

const asked = (type: Question["type"]) => server.received.filter((message) => message.type === type).length;

let server: FixtureServer;
let page: Page;

const answers = () => page.store.viewer.answers;
const settled = () =>
  vi.waitFor(() => {
    expect(page.store.viewer.statistics?.isTreeCut).toBe(true);
    expect(answers().curve?.key).toBeTruthy();
    expect(answers().distribution?.key).toMatch(/true$/);
  }, 5000);

describe("what the cards show of a surface", () => {
  beforeEach(async () => {
    vi.stubGlobal("WebSocket", WebSocket);
    vi.stubGlobal("HTMLCanvasElement", Canvas);
    server = new FixtureServer();
    server.paceMs = 2;
    page = new Page(await server.listen());
    page.page.open("ball", 0);
    page.stream.start();
  });

  afterEach(async () => {
    page.stream.stop();
    await server.close();
    vi.unstubAllGlobals();
  });

  test("is asked once the surface is final", async () => {
    await settled();
    expect(answers().curve?.value.points).toEqual(CURVE);
    expect(answers().distribution?.value.bins).toHaveLength(104);
    expect([asked("curve"), asked("distribution")]).toEqual([1, 1]);
    expect(page.stream.framesSent).toBe(2);
  });

  test("is asked anew for another surface, and the curve not for another budget", async () => {
    await settled();
    page.edit({ triangles: { share: 0.1 } });
    await vi.waitFor(() => expect(asked("distribution")).toBe(2), 5000);
    expect(asked("curve")).toBe(1);
    page.edit({ iso: 1 });
    await vi.waitFor(() => expect([asked("curve"), asked("distribution")]).toEqual([2, 3]), 5000);
    await settled();
  });

  test("is how far its vertices are off, where colours are to show it; an edit drops the question, and it is asked again", async () => {
    await settled();
    expect(asked("annotate")).toBe(0);
    page.store.changeLook({ colorBy: "error" });
    page.questions.follow();
    await vi.waitFor(() => expect(asked("annotate")).toBe(1), 5000);
    // Refused, so that the generation is what it was, but the server has dropped the question.
    page.edit({ alpha: 7 });
    await vi.waitFor(() => expect(page.errors).toHaveLength(1), 5000);
    await vi.waitFor(() => expect(asked("annotate")).toBe(2), 5000);
    page.edit({ alpha: 0.5, iso: 2 });
    await vi.waitFor(() => expect(asked("annotate")).toBe(3), 5000);
  });

  test("is not asked while a slider is dragged", async () => {
    await settled();
    for (let i = 0; i < 10; i += 1) {
      page.edit({ alpha: i / 10 });
      await new Promise((next) => setTimeout(next, 60));
    }
    expect(asked("curve")).toBe(1);
    await vi.waitFor(() => expect(asked("curve")).toBe(2), 5000);
  });

  test("is not asked of a server that does not know the question, nor while there is no surface", async () => {
    await settled();
    const known = { ...page.store.viewer, answers: {} };
    const due = (change: Partial<typeof known>) => dueQuestions({ ...known, ...change }, ["curve", "distribution"]).map(({ question }) => question.type);
    expect(due({})).toEqual(["curve", "distribution"]);
    expect(due({ questions: ["curve"] })).toEqual(["curve"]);
    expect(due({ questions: [] })).toEqual([]);
    expect(due({ working: true })).toEqual([]);
    expect(due({ connection: "waiting" })).toEqual([]);
    expect(due({ statistics: statistics(0) })).toEqual([]);
  });

  test("is asked again on a new connection", async () => {
    await settled();
    page.stream.restart();
    await vi.waitFor(() => expect([asked("curve"), asked("distribution")]).toEqual([2, 2]), 5000);
  });

  test("what lies under the pointer is asked, of many places the latest", async () => {
    await settled();
    for (let x = 0; x < 20; x += 1) page.hover([x, 0]);
    await vi.waitFor(() => expect(page.probes.length).toBe(2), 5000);
    await new Promise((next) => setTimeout(next, 200));
    expect(page.looked).toEqual([0, 19]);
    expect(page.probes.map((probed) => probed?.nearest?.blended)).toEqual([0.4, 0.4]);
    page.under = undefined;
    page.hover([50, 0]);
    await vi.waitFor(() => expect(page.probes.at(-1)).toBeUndefined(), 5000);
    expect(asked("probe")).toBe(2);
  });

  test("nothing is looked at while the server works, and what was left is not shown", async () => {
    await settled();
    page.hover([1, 0]);
    page.leave();
    await new Promise((next) => setTimeout(next, 300));
    expect(page.probes).toEqual([undefined]);
    page.edit({ iso: 1 });
    page.hover([2, 0]);
    await new Promise((next) => setTimeout(next, 50));
    expect(page.looked).toEqual([1]);
  });

  test("a click picks a value or marks a region where a tool is in hand, and orbits otherwise", async () => {
    await settled();
    page.click([7, 0]);
    await new Promise((next) => setTimeout(next, 50));
    expect(page.looked).toEqual([]);
    page.store.changePage({ tool: "pick" });
    page.click([7, 0]);
    await vi.waitFor(() => expect(page.picked).toEqual([0.4]), 5000);
    page.store.changePage({ tool: "paint", brush: 4 });
    page.click([8, 0]);
    await vi.waitFor(() => expect(page.store.view?.interest).toEqual([{ sphere: { center: [1, 2, 3], radius: 4 }, importance: 0.95 }]), 5000);
    expect(server.received.filter((message) => message.type === "edit").at(-1)).toMatchObject({ interest: [{ importance: 0.95 }] });
    page.store.undo();
    expect(page.store.view?.interest).toEqual([]);
    page.under = undefined;
    page.click([8, 0]);
    await vi.waitFor(() => expect(page.said).toHaveLength(1));
    // Tools are for the selected surface; questions are about the surface that was hit.
    page.under = [1, 2, 3];
    page.underSurface = 2;
    page.click([8, 0]);
    await vi.waitFor(() => expect(page.said[1]).toMatch(/^That is another surface/));
    page.store.changePage({ tool: "pick" });
    page.click([7, 0]);
    await vi.waitFor(() => expect(page.said).toHaveLength(3), 5000);
    expect([page.picked, page.store.view?.interest]).toEqual([[0.4], []]);
    expect(server.received.filter((message) => message.type === "probe").at(-1)).toMatchObject({ surface: 2 });
    page.press("Escape");
    expect(page.store.page.tool).toBeUndefined();
  });

  test("a click hides the part that is there or keeps it alone, and each is a step of the history", async () => {
    await settled();
    const click = async (under: Vec3, done: () => void) => {
      await vi.waitFor(() => expect(page.store.viewer.working).toBe(false), 5000);
      page.under = under;
      page.click([7, 0]);
      await vi.waitFor(done, 5000);
    };
    const parts = () => page.store.view?.parts;
    page.store.changePage({ tool: "hide-part" });
    await click([1, 2, 3.00000001], () => expect(parts()).toEqual({ hide: [[1, 2, 3]] }));
    expect(server.received.filter((message) => message.type === "edit").at(-1)).toMatchObject({ parts: { hide: [[1, 2, 3]] } });
    await click([4, 5, 6], () => expect(parts()).toEqual({ hide: [[1, 2, 3], [4, 5, 6]] }));
    page.store.changePage({ tool: "keep-part" });
    await click([7, 8, 9], () => expect(parts()).toEqual({ keep: [[7, 8, 9]] }));
    // Hiding what alone is shown would leave nothing.
    page.store.changePage({ tool: "hide-part" });
    await click([7, 8, 9], () => expect(page.said.at(-1)).toMatch(/^This is the only part/));
    page.store.undo();
    expect(parts()).toEqual({ hide: [[1, 2, 3], [4, 5, 6]] });
    page.store.undo();
    page.store.undo();
    expect(parts()).toBeNull();
    page.store.redo();
    expect(parts()).toEqual({ hide: [[1, 2, 3]] });
  });

  test("a click is not lost to a place that the pointer passed before or passes then", async () => {
    await settled();
    page.store.changePage({ tool: "hide-part" });
    page.slowAt = 6;
    page.hover([6, 0]);
    page.click([7, 0]);
    await vi.waitFor(() => expect(page.store.view?.parts ?? page.said[0]).toEqual({ hide: [[1, 2, 3]] }), 5000);
    await new Promise((next) => setTimeout(next, 200));
    await vi.waitFor(() => expect(page.store.viewer.working).toBe(false), 5000);
    page.click([7, 0]);
    page.hover([6, 0]);
    await vi.waitFor(() => expect(page.store.view?.parts).toEqual({ hide: [[1, 2, 3], [1, 2, 3]] }), 5000);
    expect([page.looked, page.said]).toEqual([[6, 7, 7, 6], []]);
  });

  test("a click where no part is found, or one that is hidden, says so and changes nothing", async () => {
    await settled();
    page.store.changePage({ tool: "hide-part" });
    for (const [nearest, words] of [
      [null, /^The full surface is too far/],
      [{ ...server.nearest!, leaf: null }, /hidden already/],
    ] as const) {
      server.nearest = nearest;
      page.click([7, 0]);
      await vi.waitFor(() => expect(page.said.at(-1)).toMatch(words), 5000);
    }
    page.under = undefined;
    page.click([7, 0]);
    await vi.waitFor(() => expect(page.said.at(-1)).toMatch(/^No surface there/), 5000);
    page.under = [1, 2, 3];
    page.underSurface = 2;
    page.click([7, 0]);
    await vi.waitFor(() => expect(page.said.at(-1)).toMatch(/^That is another surface/), 5000);
    expect(page.store.view?.parts).toBeNull();
  });

  test("points that are clicked become distances and angles, and what is read at one a reading", async () => {
    await settled();
    const click = async (under: Vec3, done: () => void) => {
      page.under = under;
      page.press("Enter");
      await vi.waitFor(done, 5000);
    };
    const { store } = page;
    store.changePage({ tool: "distance" });
    await click([1, 2, 3.00000004], () => expect(store.page.picked).toEqual([[1, 2, 3]]));
    await click([1, 2, 7], () => expect(store.look.measures).toEqual([{ kind: "distance", points: [[1, 2, 3], [1, 2, 7]] }]));
    expect(store.page.picked).toEqual([]);
    store.changePage({ tool: "angle" });
    await click([1, 0, 0], () => expect(store.page.picked).toHaveLength(1));
    // Another tool begins without picked points.
    store.changePage({ tool: "reading" });
    expect(store.page.picked).toEqual([]);
    await click([4, 5, 6], () => expect(store.look.measures).toHaveLength(2));
    // The fixture answers for one of the two fields.
    expect(store.look.measures[1]).toEqual({ kind: "reading", points: [[4, 5, 6]], values: [1.5, null] });
    store.undo();
    store.undo();
    expect(store.look.measures).toEqual([]);
    store.redo();
    expect(store.look.measures).toHaveLength(1);
    page.under = undefined;
    page.press("Enter");
    await vi.waitFor(() => expect(page.said).toEqual(["No surface there: click on the surface itself"]), 5000);
  });

  test("an error about a question changes nothing", async () => {
    await settled();
    const before = page.store.state;
    const error = { type: "error", code: "no-surface", message: "nothing is shown", open: true } as const;
    page.store.dispatch({ type: "message", message: error });
    expect(page.store.state).toEqual(before);
    expect([error, { ...error, code: "bad-edit" }].map(isAboutQuestion)).toEqual([true, false]);
  });
});

describe("the curve of the error", () => {
  const size = { width: 100, height: 60 };

  test("is read between its points", () => {
    expect(errorAt(CURVE, 1000)).toBeCloseTo(0.1);
    expect(errorAt(CURVE, Math.sqrt(1000 * 500))).toBeCloseTo(Math.sqrt(0.1 * 0.2));
    expect(errorAt(CURVE, 4000)).toBe(0);
    expect(errorAt(CURVE, 249)).toBeUndefined();
    expect(errorAt([], 100)).toBeUndefined();
  });

  test("says how many triangles an error takes", () => {
    expect(trianglesFor(CURVE, 0.1)).toBeCloseTo(1000);
    expect(trianglesFor(CURVE, 0.15)).toBeCloseTo(1000 * 2 ** -Math.log2(1.5));
    expect(trianglesFor(CURVE, 9)).toBeUndefined();
    for (const rms of [0.01, 0.07, 0.3]) expect(errorAt(CURVE, trianglesFor(CURVE, rms)!)).toBeCloseTo(rms);
  });

  test("goes through what was measured", () => {
    for (const [measured, estimated] of [[0.25, 0.1], [0.05, 0.1]] as const) {
      const points = corrected(CURVE, correctionOf(measured, estimated));
      expect(errorAt(points, 1000)).toBeCloseTo(measured);
      expect(points.map(({ triangles }) => triangles)).toEqual(CURVE.map(({ triangles }) => triangles));
    }
    // The full surface is off too.
    expect(errorAt(corrected(CURVE, correctionOf(0.05, 0.03)), 4000)).toBeCloseTo(0.04);
    expect(errorAt(corrected(CURVE, correctionOf(0.03, 0)), 4000)).toBeCloseTo(0.03);
    expect(corrected(CURVE, NO_CORRECTION)).toEqual(CURVE);
  });

  test("lies on the axis of the slider", () => {
    expect([1, 0.001].map((share) => toX(share, size))).toEqual([100, 0]);
    expect([5, 0.005, 0, 100].map((error) => toY(error, size))).toEqual([0, 60, 60, 0]);
    expect(linePath(CURVE, 4000, 1, size)).toMatch(/^M59\.9 .*L100\.0 60\.0$/);
    expect(linePath([], 4000, 1, size)).toBe("");
  });

  test("has texts that stay in it and off each other", () => {
    const plot = { width: 296, height: 46 };
    // Beside its line on the left; on the right of it if the left is occupied; nowhere else.
    expect(fineSide("0.1 mm", 200, 250, plot)).toBe("end");
    expect([fineSide("0.1 mm", 10, 250, plot), fineSide("0.1 mm", 240, 235, plot)]).toEqual(["start", "start"]);
    expect(fineSide("0.1 voxels", 270, 235, plot)).toBeUndefined();
    const meets = (x: number, error: number) => meetsAxisText("1 voxel", "≈ 0.33 voxels", x, error, plot);
    expect([meets(236, 0.33), meets(236, 0.02), meets(60, 0.33)]).toEqual([true, false, false]);
    expect(meetsAxisText("1 voxel", "", 236, 0, plot)).toBe(false);
  });

  test("is said in words", () => {
    const found = { ...statistics(100), fullTriangles: 4000 };
    expect(shareWords(0.25, 1000, found, "0.1 voxels")).toBe("25 percent, 1,000 of 4,000 triangles, error about 0.1 voxels");
    expect(shareWords(0.25, 1000, found, undefined)).toBe("25 percent, 1,000 of 4,000 triangles");
    expect(shareWords(1, NaN, undefined, undefined)).toBe("not known yet");
    expect(curveWords({ points: CURVE, full: 4000, lengths: voxels(1), share: 1, maximum: undefined })).toBe(
      "Estimated error against triangles: 0.4 voxels with 250, none with 4,000; 0.1 voxels with 25 % of them",
    );
  });
});

describe("regions of interest that are marked", () => {
  const ball = (x: number, radius: number): Interest[number] => ({ sphere: { center: [x, 0, 0], radius }, importance: 0.95 });

  test("become one where they are near, and stay as large as the two need", () => {
    expect(paint([ball(0, 10)], [1, 0, 0], 2)).toEqual([ball(0, 10)]);
    expect(paint([ball(0, 1)], [0.5, 0, 0], 1)).toEqual([ball(0.25, 1.25)]);
    expect(paint([ball(0, 1)], [3, 0, 0], 1)).toEqual([ball(0, 1), ball(3, 1)]);
    // A small one beside a large one does not make it much larger.
    expect(paint([ball(0, 10)], [15, 0, 0], 1)).toHaveLength(2);
    // The one between two is near both, and all three become one.
    expect(paint([ball(0, 1), ball(1, 1)], [0.5, 0, 0], 1)).toHaveLength(1);
  });

  test("leave those of a link alone, and are at most 64", () => {
    const box = { box: { min: [0, 0, 0], max: [1, 1, 1] }, importance: 0.95 } as const;
    const other = { sphere: { center: [0, 0, 0], radius: 1 }, importance: 0.5 } as const;
    expect(paint([box, other], [0, 0, 0], 1)).toEqual([box, other, ball(0, 1)]);
    const full = Array.from({ length: MAX_REGIONS }, (_, i) => ball(10 * i, 1));
    expect(paint(full, [-10, 0, 0], 1)).toBe(full);
    expect(paint(full, [0.2, 0, 0], 1)).toHaveLength(MAX_REGIONS);
  });
});

test("what was found is listed, as far as it is known", () => {
  const nearest = { distance: 0.1, smoothness: 0.5, feature: 3, blended: 0.412, importance: 0.31, leaf: { kind: "tree", level: 2, error: 0.1 }, part: 3, partArea: 1234.5 } as const;
  const probed = { type: "probed", surface: 0, generation: 1, position: [0, 0, 0], inside: true, values: [{ field: "depth", value: 1.23456 }, { field: "height", value: null, why: "not-resident" }], nearest } as const;
  expect(probeRows(probed, VOLUMES[0], voxels(0.5))).toEqual([
    ["depth", "1.235 mm"],
    ["importance", "0.31"],
    ["importance input", "0.41"],
    ["area of this part", "1230 world units²"],
    ["level", "2"],
    ["error", "≈ 0.2 voxels"],
  ]);
  expect(probeRows({ ...probed, nearest: null }, VOLUMES[0], voxels(1))).toEqual([["depth", "1.235 mm"]]);
  expect(probeRows({ ...probed, nearest: { ...nearest, leaf: null } }, undefined, voxels(1))).toHaveLength(4);
  expect(probeRows({ ...probed, nearest: { ...nearest, partArea: null } }, VOLUMES[0], voxels(1))).toHaveLength(5);
});
