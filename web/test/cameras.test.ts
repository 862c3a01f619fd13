import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import type { ServerMessage, ViewCamera } from "../src/protocol/types";
import { complete } from "../src/protocol/view";
import { sightOf, type CameraPose } from "../src/scene/pose";
import { commandLine } from "../src/state/commandLine";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { isCameraAwaited, isFollowingCamera } from "../src/state/viewer";
import { convertedError, errorInUnit, errorLimit, typedError } from "../src/ui/cards/errorUnits";
import { criterion, inSpacings } from "../src/ui/cards/criterion";
import { formatPixels, limitsOf, pixelLimit } from "../src/ui/cards/limits";
import { Cameras, pictureCamera } from "../src/wiring/cameras";
import { ActingStore } from "./acting";
import { CAPABILITIES, OPENING, statistics, VOLUMES } from "./fixture";

const POSE: CameraPose = { position: [0, -10, 0], target: [0, 0, 0], projection: "perspective" };

describe("what a camera sees", () => {
  test("has an angle, or a height at the target", () => {
    expect(sightOf(POSE, Math.PI / 2, 10)).toEqual({ position: [0, -10, 0], target: [0, 0, 0], fov: 90 });
    expect(sightOf({ ...POSE, projection: "orthographic" }, Math.PI / 2, 10).height).toBeCloseTo(20, 9);
  });

  test("has another direction upwards from above and below", () => {
    const up = (position: CameraPose["position"]) => sightOf({ ...POSE, position }, 1, 10).up;
    expect([up([0, 0, 5]), up([0, 0, -5]), up([0, 1, 1])]).toEqual([[-1, 0, 0], [1, 0, 0], undefined]);
    // As the view along the axis is tilted.
    expect(up([0, -1e-6, 1])).toEqual([0, 1, 0]);
    expect(up([0, 1e-6, -1])).toEqual([0, 1, 0]);
  });

  test("has the pixels of its picture", () => {
    const scene = { camera: { pose: POSE, sight: () => sightOf(POSE, 1, 10) }, size: { width: 301, height: 200 } };
    expect(pictureCamera(scene, POSE, 1.5).viewport).toEqual([452, 300]);
  });
});

/** A page with a scene and a connection, whose answers the test gives. */
class Page {
  readonly store = new ActingStore();
  readonly sent: (ViewCamera | null)[] = [];
  pose = POSE;
  isFitted = true;
  isLed = false;
  stills = 0;
  readonly cameras: Cameras;

  constructor() {
    const poseNow = () => this.pose;
    const fittedPose = () => (this.isFitted ? this.pose : undefined);
    this.cameras = new Cameras({
      store: this.store,
      scene: { camera: { get pose() { return poseNow(); }, sight: (pose?: CameraPose) => sightOf(pose ?? poseNow(), 1, 10) }, size: { width: 300, height: 200 } },
      pixelRatio: () => 1,
      framing: { get pose() { return fittedPose(); } },
      client: {
        isNewCamera: (camera) => JSON.stringify(camera) !== JSON.stringify(this.sent.at(-1)),
        sendCamera: (camera) => {
          if (JSON.stringify(camera) === JSON.stringify(this.sent.at(-1))) return false;
          this.sent.push(camera);
          return true;
        },
      },
      isLed: () => this.isLed,
      isSettled: () => !this.cameras.isDue && !isCameraAwaited(this.store.viewer),
      onStill: () => (this.stills += 1),
    });
    this.store.dispatch({ type: "connection", state: "connected" });
    this.store.open({ type: "opened", volume: VOLUMES[0]!, step: 0, edit: OPENING, device: "", capabilities: CAPABILITIES });
    this.store.dispatch({ type: "sent", surface: 0, at: 0 });
    this.generation(1);
  }

  receive(message: ServerMessage): void {
    this.store.dispatch({ type: "message", message });
  }

  begin(generation: number): void {
    this.receive({ type: "prefix", surface: 0, generation, level: 0, kind: "cut", mesher: "dual", regions: 1, unchanged: 0, triangles: 1, final: true });
  }

  generation(generation: number, change: object = {}): void {
    this.begin(generation);
    this.receive({ type: "done", trace: "", surface: 0, generation, statistics: { ...statistics(100), ...change } });
    this.cameras.changed();
  }

  move(x: number): void {
    this.pose = { ...POSE, position: [x, -10, 0] };
    this.cameras.changed();
  }

  get xs(): (number | undefined)[] {
    return this.sent.map((camera) => camera?.position[0]);
  }
}

describe("the page's camera", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  const moved = (page: Page, x: number, ms = 40) => {
    page.move(x);
    vi.advanceTimersByTime(ms);
  };

  test("is sent once, and again when it has moved; the last is not lost", () => {
    const page = new Page();
    page.cameras.changed();
    vi.advanceTimersByTime(100);
    expect(page.xs).toEqual([0]);
    moved(page, 1);
    moved(page, 2);
    // One is on its way at a time.
    expect(page.xs).toEqual([0]);
    page.generation(2);
    vi.advanceTimersByTime(40);
    expect(page.xs).toEqual([0, 2]);
    page.generation(3);
    vi.advanceTimersByTime(500);
    expect(page.xs).toEqual([0, 2]);
  });

  test("is sent at most 30 times a second", () => {
    const page = new Page();
    for (let ms = 0; ms < 1000; ms += 5) {
      moved(page, ms, 5);
      if (isCameraAwaited(page.store.viewer)) page.generation(page.store.viewer.finished! + 1);
    }
    expect(page.sent.length).toBeGreaterThan(20);
    expect(page.sent.length).toBeLessThanOrEqual(31);
  });

  test("is not sent before it is fitted, during an edit, or if no surface follows it", () => {
    const page = new Page();
    [page.isFitted, page.sent.length] = [false, 0];
    page.cameras.changed();
    vi.advanceTimersByTime(100);
    page.isFitted = true;
    page.store.dispatch({ type: "sent", surface: 0, at: 0 });
    moved(page, 1);
    expect(page.sent).toEqual([]);
    page.generation(2);
    vi.advanceTimersByTime(40);
    expect(page.xs).toEqual([1]);
    page.generation(3);
    for (const edit of [{ detail: "uniform" }, { beta: 0.1 }, { mesher: "marching-cubes" }] as const) {
      page.store.edit(edit);
      moved(page, 2, 400);
      expect(page.cameras.isDue).toBe(false);
      page.store.dispatch({ type: "undo" });
    }
    expect(page.xs).toEqual([1]);
  });

  test("is none of a follower's own until the follower turns it", () => {
    const page = new Page();
    page.generation(2);
    page.isLed = true;
    moved(page, 1);
    moved(page, 2);
    expect(page.sent.slice(1)).toEqual([null]);
    // Nothing need come for that.
    expect(isCameraAwaited(page.store.viewer)).toBe(false);
    page.isLed = false;
    moved(page, 3);
    expect(page.xs.slice(1)).toEqual([undefined, 3]);
  });

  test("is still a while after its last move, once the surface is made for it", () => {
    const page = new Page();
    moved(page, 1, 400);
    expect([page.cameras.isStill, page.stills]).toEqual([false, 1]);
    page.generation(2);
    vi.advanceTimersByTime(40);
    page.generation(3);
    expect(page.cameras.isStill).toBe(true);
    moved(page, 2, 100);
    page.generation(4);
    expect(page.cameras.isStill).toBe(false);
  });

  test("goes on if the server makes nothing for one", () => {
    const page = new Page();
    page.cameras.changed();
    moved(page, 1, 11_000);
    expect(page.xs).toEqual([0, 1]);
  });

  test("of an image is sent before the image is made, and the page's own after it", async () => {
    const page = new Page();
    page.generation(2);
    let isMade = false;
    const image = page.cameras.image(2, (pose) => {
      expect(pose).toEqual(POSE);
      isMade = true;
      return Promise.resolve("png");
    });
    await vi.advanceTimersByTimeAsync(200);
    expect(page.sent.at(-1)?.viewport).toEqual([600, 400]);
    expect(isMade).toBe(false);
    page.generation(3);
    await vi.advanceTimersByTimeAsync(100);
    expect(await image).toBe("png");
    await vi.advanceTimersByTimeAsync(100);
    expect(page.sent.at(-1)?.viewport).toEqual([300, 200]);
  });
});

describe("a generation for a camera", () => {
  const awaiting = () => {
    const page = new Page();
    page.store.dispatch({ type: "camera", surfaces: [0] });
    return page;
  };

  test("is no work of an edit, and has none of its times and bytes", () => {
    const page = awaiting();
    expect(isCameraAwaited(page.store.viewer)).toBe(true);
    const before = page.store.viewer.progress;
    page.begin(2);
    page.store.dispatch({ type: "chunk", bytes: 1000 });
    expect(page.store.viewer).toMatchObject({ working: false, edited: 1, progress: { ...before, generation: 2 } });
    expect(isFollowingCamera(page.store.viewer)).toBe(true);
    page.generation(2);
    expect(isCameraAwaited(page.store.viewer)).toBe(false);
    // An edit's is one.
    page.store.dispatch({ type: "sent", surface: 0, at: 5 });
    page.begin(3);
    expect(page.store.viewer).toMatchObject({ working: true, edited: 3, progress: { bytes: 0 } });
    expect(isFollowingCamera(page.store.viewer)).toBe(false);
  });

  test("comes after the better surface of the same view", () => {
    const page = new Page();
    page.store.dispatch({ type: "sent", surface: 0, at: 5 });
    page.generation(2, { isTreeCut: false });
    page.store.dispatch({ type: "camera", surfaces: [0] });
    expect(isCameraAwaited(page.store.viewer)).toBe(false);
    page.generation(2);
    expect(isCameraAwaited(page.store.viewer)).toBe(true);
    page.generation(3);
    expect(isCameraAwaited(page.store.viewer)).toBe(false);
  });

  test("is one of the member in control until that member's next edit", () => {
    const page = new Page();
    page.receive({ type: "posed", camera: { position: [0, 0, 1], target: [0, 0, 0], projection: "perspective" } });
    page.begin(2);
    expect(page.store.viewer.working).toBe(false);
    page.generation(2);
    page.receive({ type: "led", volume: "ball", step: 0, surfaces: [] });
    page.begin(3);
    expect(page.store.viewer.working).toBe(true);
  });

  test("is not awaited after a refusal, or on another connection", () => {
    const refused = awaiting();
    refused.receive({ type: "error", code: "bad-message", message: "", open: true });
    expect(isCameraAwaited(refused.store.viewer)).toBe(false);
    const lost = awaiting();
    lost.store.dispatch({ type: "connection", state: "waiting" });
    expect(isCameraAwaited(lost.store.viewer)).toBe(false);
  });
});

describe("errors in pixels", () => {
  test("are read, converted and typed", () => {
    expect(["1px", "0.25vx", "0.5", 3].map(errorInUnit)).toEqual([{ value: 1, unit: "px" }, { value: 0.25, unit: "vx" }, { value: 0.5, unit: "world" }, { value: 3, unit: "world" }]);
    expect((["px", "vx", "world"] as const).map((unit) => errorLimit({ value: 2, unit }))).toEqual(["2px", "2vx", 2]);
    expect((["px", "vx", "world"] as const).map((unit) => convertedError("2px", unit, 3).value)).toEqual([2, 0.2, 0.6]);
    expect(["2 px", "0.1vx", "1 voxel", "3mm", "0.5", "many px"].map((text) => typedError(text, "mm"))).toEqual([
      { value: 2, unit: "px" },
      { value: 0.1, unit: "vx" },
      { value: 1, unit: "vx" },
      { value: 3, unit: "world" },
      undefined,
      undefined,
    ]);
    expect(["1px", "1vx", 3].map((error) => inSpacings(error, 3))).toEqual([0.1, 1, 1]);
  });

  const pixels = (limitedBy: "error" | "budget" | "pixels" | "guard" | "data", within = 0.834) => ({ ...statistics(100), tolerance: 9, pixels: { within, limitedBy } });

  test("are said with what limits them", () => {
    const texts = (["error", "budget", "pixels", "guard", "data"] as const).map((by) => pixelLimit(OPENING, pixels(by))?.text);
    expect(texts).toEqual([
      "Error up to about 0.83 px at this view: as asked",
      "Error up to about 0.83 px at this view: the budget allows no finer",
      "Error up to about 0.83 px at this view: finer would not show",
      "Error up to about 0.83 px at this view: the guard on the error is finer",
      "Error up to about 0.83 px at this view: this is the full surface",
    ]);
    expect([formatPixels(12.34), formatPixels(0)]).toEqual(["12 px", "less than 0.01 px"]);
    expect(pixelLimit(OPENING, pixels("budget"))?.lift?.edit).toEqual({ error: "1px" });
    expect(pixelLimit(OPENING, pixels("error"))?.lift?.edit).toEqual({ triangles: OPENING.triangles });
  });

  test("take the place of other limits, and have a place before they are known", () => {
    expect(limitsOf(OPENING, pixels("error"), undefined, { spacing: 1, unit: "mm" })).toEqual([]);
    expect(pixelLimit(OPENING, statistics(100))?.text).toBe("The error at this view is not known yet");
    expect(pixelLimit({ ...OPENING, detail: "uniform" }, statistics(100))).toBeUndefined();
    expect((["budget", "error", "pixels"] as const).map((by) => criterion(OPENING, pixels(by), 1))).toEqual(["triangles", "error", "error"]);
  });
});

describe("links and command lines", () => {
  const link = (change: object) => encodeLink({ volume: "a", step: 0, surfaces: [{ number: 0, view: { ...OPENING, ...change }, style: DEFAULT_STYLE }], selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined });

  test("a link has the detail if it is another one, and errors with their units", () => {
    expect(link({})).not.toContain("detail");
    expect(link({ detail: "uniform" })).toContain("detail=uniform");
    expect(decodeLink(link({ detail: "uniform", error: "2px", triangles: undefined }))?.surfaces[0]?.edit).toMatchObject({ detail: "uniform", error: "2px" });
  });

  test("a command makes what is seen", () => {
    const camera: ViewCamera = { position: [0, -10, 1.5], target: [1, 2, 3], fov: 32, viewport: [800, 600] };
    const line = (change: object, at = camera) => commandLine("a", 0, { ...OPENING, ...change }, undefined, at);
    expect(line({})).toContain("--error 1px --triangles 25% --camera 0,-10,1.5,1,2,3 --viewport 800x600 --fov 32 --max-error");
    const { fov: _, ...rest } = camera;
    expect(line({}, { ...rest, height: 7, up: [0, 1, 0] })).toContain("--camera 0,-10,1.5,1,2,3,0,1,0 --viewport 800x600 --view-height 7 ");
    for (const change of [{ detail: "uniform" }, complete({ beta: 0.1 }), { mesher: "marching-cubes" }]) expect(line(change)).not.toContain("--camera");
    expect(line({ detail: "uniform" })).toContain("--detail uniform");
  });
});
