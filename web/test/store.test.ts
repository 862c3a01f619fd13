import { describe, expect, test } from "vitest";
import type { View } from "../src/protocol/types";
import { commandLine } from "../src/state/commandLine";
import { amend, cancelGesture, canUndo, drag, endGesture, push, redo, startHistory, undo, type History } from "../src/state/history";
import { decodeLink, encodeLink, type LinkState } from "../src/state/link";
import { LinkError } from "../src/state/linkReader";
import { DEFAULT_LOOK, openingLook, type Look } from "../src/state/look";
import { DEFAULT_STYLE, type SurfaceStyle } from "../src/state/surfaceList";
import { complete } from "../src/protocol/view";
import { ActingStore } from "./acting";
import { CAPABILITIES, OPENING, statistics, VOLUMES } from "./fixture";

describe("history", () => {
  const drags = <T>(history: History<T>, values: readonly T[], name?: string) => values.reduce((now, value) => drag(now, value, name), history);

  test("a drag is one step", () => {
    const undone = undo(endGesture(drags(push(startHistory(0), 1), [2, 3, 4])));
    expect(undone.current).toBe(1);
    const redone = redo(undone);
    expect([redone.current, redone.future]).toEqual([4, []]);
  });

  test("undo in the middle of a drag takes the drag back", () => {
    expect(undo(drag(startHistory("a"), "b")).current).toBe("a");
  });

  test("a new step forgets what was undone", () => {
    const history = push(undo(push(startHistory(0), 1)), 2);
    expect(redo(history)).toEqual(history);
    expect(history.current).toBe(2);
  });

  test("is bounded", () => {
    const history = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10].reduce((now, value) => push(now, value, 3), startHistory(0));
    expect(history.past).toEqual([7, 8, 9]);
  });

  test("a drag back to its start is no step", () => {
    expect(canUndo(endGesture(drags(startHistory(5), [6, 5])))).toBe(false);
  });

  test("a gesture of another name is another step", () => {
    const history = undo(endGesture(drag(drags(startHistory(0), [1, 2], "iso"), 3, "alpha")));
    expect([history.current, undo(history).current]).toEqual([2, 0]);
  });

  test("a gesture that is cancelled was no step, and an amended value forgets nothing", () => {
    const dragged = drag(undo(push(startHistory(0), 1)), 7, "iso");
    expect(cancelGesture(dragged, "alpha")).toBe(dragged);
    const cancelled = cancelGesture(dragged, "iso");
    expect([cancelled.current, canUndo(cancelled), redo(amend(cancelled, 5)).current]).toEqual([0, false, 1]);
  });
});

const surfaceOf = (view: View, number = 0, style: Partial<SurfaceStyle> = {}) => ({ number, view, style: { ...DEFAULT_STYLE, ...style } });

const opened = (id: string): Parameters<ActingStore["open"]>[0] => ({
  type: "opened",
  volume: VOLUMES.find((v) => v.id === id)!,
  step: 0,
  edit: OPENING,
  device: "Fixture",
  capabilities: CAPABILITIES,
});

/** A store in which a volume was opened. */
const open = (store: ActingStore, id: string, wish?: Parameters<ActingStore["open"]>[1]) => store.open(opened(id), wish);

describe("the store", () => {
  test("undoes edits, colours and looks in the order in which they came", () => {
    const store = new ActingStore();
    open(store, "ball");
    expect(store.canUndo).toBe(false);
    store.edit({ iso: 1 }, "iso");
    store.edit({ iso: 2 }, "iso");
    store.endGesture();
    store.changeLook({ wireframe: true });
    store.edit({ transferFunction: { points: [{ x: 0, importance: 1, color: "#ff0000" }] } });
    store.undo();
    expect(store.view?.transferFunction).toEqual(OPENING.transferFunction);
    expect(store.look.wireframe).toBe(true);
    store.undo();
    expect([store.look.wireframe, store.view?.iso]).toEqual([false, 2]);
    store.undo();
    expect([store.view?.iso, store.canUndo, store.canRedo]).toEqual([0, false, true]);
    store.redo();
    store.redo();
    expect([store.view?.iso, store.look.wireframe]).toEqual([2, true]);
  });

  test("an edit of what decides takes the place of all that decided", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.edit({ beta: 0.1 });
    expect(store.view).toMatchObject({ beta: 0.1, error: undefined, triangles: undefined });
    store.undo();
    expect(store.view).toMatchObject({ error: OPENING.error, triangles: OPENING.triangles, beta: undefined });
  });

  test("a link with another field and no isovalue shows it as it opens", () => {
    const [store, wish] = [new ActingStore(), decodeLink("#volume=ball&field=height")!];
    open(store, "ball", wish);
    const height = VOLUMES[0]!.fields.find(({ name }) => name === "height")!;
    expect(store.view).toMatchObject({ field: "height", iso: height.openingIso!.iso, featureRange: OPENING.featureRange });
    open(store, "ball-mirrored", decodeLink("#volume=ball-mirrored&field=height&iso=3&feature=gradient-magnitude"));
    expect(store.view).toMatchObject({ field: "height", iso: 3 });
    store.replace(decodeLink("#volume=ball-mirrored&field=height&feature=gradient-magnitude")!);
    expect(store.view?.featureRange).toEqual(height.derivedFeatures["gradient-magnitude"]!.range);
  });

  test("keeps each volume's work, with its history and its camera", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.edit({ iso: 5 });
    const pose = { position: [1, 2, 3], target: [0, 0, 0] } as const;
    store.leave(pose);
    expect(open(store, "ball-mirrored")).toBeUndefined();
    expect([store.view?.iso, store.canUndo]).toEqual([0, false]);
    store.leave(undefined);
    expect(open(store, "ball")).toEqual(pose);
    expect([store.view?.iso, store.canUndo]).toEqual([5, true]);
    store.undo();
    expect(store.view?.iso).toBe(0);
  });

  test("keeps the history over a reconnection", () => {
    const store = new ActingStore();
    open(store, "ball");
    store.edit({ iso: 5 });
    open(store, "ball");
    expect(store.canUndo).toBe(true);
  });

  test("opens as a link says, which is no step", () => {
    const store = new ActingStore();
    const pose = { position: [1, 2, 3], target: [0, 0, 0] } as const;
    expect(open(store, "ball", { surfaces: [{ edit: { beta: 0.3 }, style: {} }], selected: 0, look: { ...DEFAULT_LOOK, colorBy: "level" }, pose })).toEqual(pose);
    expect(store.view).toEqual({ ...OPENING, ...complete({ beta: 0.3 }) });
    expect([store.look.colorBy, store.canUndo]).toEqual(["level", false]);
    // A link that is followed later starts from how the volume opens.
    store.replace({ surfaces: [{ edit: { iso: 2 }, style: {} }], selected: 0, look: DEFAULT_LOOK });
    expect(store.view).toEqual({ ...OPENING, iso: 2 });
    store.undo();
    expect(store.view?.beta).toBe(0.3);
  });
});

describe("a link", () => {
  const state: LinkState = { volume: "ct head/1", step: 2, surfaces: [surfaceOf(OPENING)], selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined };
  const back = (view: Partial<typeof OPENING>) => {
    const link = decodeLink(`#${encodeLink({ ...state, surfaces: [surfaceOf({ ...OPENING, ...view })] })}`);
    return { ...OPENING, ...complete(link?.surfaces[0]?.edit ?? {}) };
  };

  test("of a volume as it opens is short, and names its version", () => {
    expect(encodeLink(state)).toBe("v=1&volume=ct%20head%2F1&step=2&iso=0");
    expect(decodeLink(encodeLink(state))).toEqual({ volume: "ct head/1", step: 2, surfaces: [{ edit: { iso: 0 }, style: {} }], selected: 0, look: {}, pose: undefined });
    expect(decodeLink("#volume=ball")).toMatchObject({ volume: "ball", step: 0, surfaces: [{ edit: {} }] });
    expect(decodeLink("#")).toBeUndefined();
  });

  test("brings every value back", () => {
    const { points } = OPENING.transferFunction;
    const views: Partial<typeof OPENING>[] = [
      { iso: -6.5727744, alpha: 0.25, maxLevel: 3, topology: "free", maxError: null },
      { field: "height", feature: "none", featureRange: [-3, 400.5], minPart: 12, mask: "labels==1,4..7" },
      { parts: { hide: [[1, -2.5, 3e-7]] } },
      { parts: { keep: [[1, 2, 3], [-4.25, 5, 1e9]] } },
      complete({ triangles: 1500 }),
      complete({ triangles: { share: 0.03 } }),
      complete({ triangles: { share: 0.03, max: 9000 }, error: 0.5 }),
      { ...complete({ beta: -1 }), mesher: "marching-cubes", maxError: "0.25vx" },
      complete({ bytes: 400_000 }),
      { transferFunction: { points: [...points, { x: 1, importance: 0.25, color: "#00ff40" }] } },
      { interest: [{ sphere: { center: [1, -2, 3.5], radius: 4 }, importance: 0.5 }, { box: { min: [0, 0, 0], max: [1, 2, 3] }, importance: 1 }] },
    ];
    for (const view of views) {
      expect(back(view)).toEqual({ ...OPENING, ...view });
    }
  });

  test("names no look that the volume opens with, and every one that it does not", () => {
    const openingLook: Look = { ...DEFAULT_LOOK, colorBy: "transfer" };
    expect(encodeLink({ ...state, look: openingLook, openingLook })).not.toContain("color");
    expect(encodeLink({ ...state, openingLook })).toContain("color=material");
  });

  test("brings look and camera back", () => {
    const pose = { position: [1.25, -300, 0.1], target: [0, 5, 1e-3] } as const;
    const look: Look = {
      ...DEFAULT_LOOK,
      colorBy: "importance",
      map: "vik",
      wireframe: true,
      occlusion: false,
      orthographic: true,
      finestLevel: 2,
      clip: { plane: { normal: [0, 0.6, -0.8], offset: -3.5 }, box: { min: [-1, -2, -3], max: [1, 2, 3] }, caps: false },
      slices: { planes: [null, 0, 12], window: [-40, 300] },
    };
    const read = decodeLink(encodeLink({ ...state, look, pose }));
    expect({ ...DEFAULT_LOOK, ...read?.look }).toEqual(look);
    expect(read?.pose).toEqual(pose);
    expect(decodeLink("#volume=a&peel=99&wire=0")?.look).toEqual({ finestLevel: 5, wireframe: false });
    for (const [hash, wrong] of [
      ["color=x", "“color” is \"x\", expected one of material, transfer"],
      ["wire=yes", "“wire” is \"yes\", expected 0 or 1"],
      ["plane=0,0,0,1", "“plane” has no direction"],
      ["clip=1,2,3", "“clip” has 3 numbers, expected 6"],
      ["slices=1", "“slices” has 1 places, expected 3"],
    ] as const) {
      expect(() => decodeLink(`#volume=a&${hash}`)).toThrow(wrong);
    }
  });

  test("that is broken says where", () => {
    const broken = (hash: string) => expect(() => decodeLink(hash), hash);
    broken("#v=2&volume=a").toThrow(/version 2/);
    broken("#volume=a&iso=high").toThrow(/“iso” is "high", expected a number/);
    broken("#volume=a&camera=1,2,3").toThrow(/“camera” has 3 numbers, expected 6/);
    broken("#volume=a&tf=0,1,zzzzzz").toThrow(/colour "zzzzzz"/);
    for (const parts of ["", "hide", "hide:", "show:1,2,3", "1,2,3"]) broken(`#volume=a&parts=${parts}`).toThrow(/“parts” is ".*", expected all, or hide: or keep: and places/);
    broken("#volume=a&parts=hide:1,2").toThrow(/“parts” has 2 numbers, expected 3/);
    broken("#volume=a&s2.iso=1&s2.parts=keep:1,2,x").toThrow(/“s2.parts” is "x", expected a number/);
    broken("#volume=a&roi=1,2").toThrow(/“roi” has 2 numbers/);
    broken("#volume=%E0%A4%A").toThrow(LinkError);
    broken("#volume=a&iso=").toThrow(/“iso”/);
    expect(decodeLink("#volume=a&newer=3")).toMatchObject({ volume: "a" });
  });
});

describe("the command line", () => {
  test("names every value in force", () => {
    const line = commandLine("ct head", 0, { ...OPENING, ...complete({ triangles: { share: 0.25, max: 50 } }) }, { ...statistics(50), fullTriangles: 400 });
    expect(line).toBe(
      "isopeel extract 'ct head' --iso 0 --field depth --feature height --feature-range 0 1 --alpha 0.6 --triangles 50 " +
        "--max-error auto --topology auto --mesher dual --max-level 5 " +
        `--transfer-function <(echo '${JSON.stringify(OPENING.transferFunction)}') -o 'ct head.glb'`,
    );
  });

  test("has shares, guards that are off, and regions", () => {
    const view = {
      ...OPENING,
      ...complete({ triangles: { share: 0.25, max: 5000 }, error: "0.1vx" }),
      feature: "none",
      maxError: null,
      minPart: 3,
      interest: [{ sphere: { center: [1, -2, 3] as const, radius: 4 }, importance: 0.5 }],
    };
    const line = commandLine("a", 3, view, { ...statistics(50), fullTriangles: 400 });
    expect(line).toContain("--step 3 --error 0.1vx --triangles 25% --min-part 3 --max-error none");
    expect(line).toContain("--interest 'sphere:1,-2,3:4=0.5'");
    expect(line).not.toContain("--alpha");
    expect(commandLine("a", 0, { ...OPENING, ...complete({ beta: -1 }) }, undefined)).toContain("--beta -1");
    expect(commandLine("a", 0, { ...OPENING, parts: { hide: [[-1, 2, 3], [4, 5, 6.5]] } }, undefined)).toContain("--hide-part -1,2,3 --hide-part 4,5,6.5 --max-error");
    expect(commandLine("a", 0, { ...OPENING, parts: { keep: [[1, 2, 3]] } }, undefined)).toContain("--keep-part 1,2,3");
    expect([false, true].map((cap) => commandLine("a", 0, { ...OPENING, cap }, undefined).includes(" --cap "))).toEqual([false, true]);
  });
});

test("a volume that brings its colours along opens with them, another one in one colour", () => {
  const [ball] = VOLUMES;
  if (ball === undefined) throw new Error("no volume");
  expect(openingLook(ball).colorBy).toBe("material");
  expect(openingLook({ ...ball, opening: { iso: 1 } }).colorBy).toBe("material");
  expect(openingLook({ ...ball, opening: { transferFunction: { points: [] } } }).colorBy).toBe("transfer");
});
