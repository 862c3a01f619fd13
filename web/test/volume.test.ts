/** The volume at a low resolution: its place, what is asked of the server, and links. */

import { Matrix4, Vector3, Vector4 } from "three";
import { expect, test } from "vitest";
import { readOverview, type Overview, type OverviewRequest } from "../src/net/overview";
import { planesIn, type RayVolume } from "../src/scene/rays";
import { evenCodes, placeInTexture } from "../src/scene/volumePicture";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK, NO_VOLUME, type Look } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { volumeWanted } from "../src/wiring/volumeDisplay";
import { VolumeShower } from "../src/wiring/volumeShower";
import { OPENING, VOLUMES } from "./fixture";

const [volume] = VOLUMES;
if (volume === undefined) throw new Error("a volume expected");

const SURFACE = { number: 0, view: OPENING, style: DEFAULT_STYLE };
const OVERVIEW: Overview = { dims: [2, 3, 2], factors: [2, 1, 1], range: [-1, 5], codes: Uint8Array.from({ length: 12 }, (_, i) => i) };
const GRID = { origin: [10, 20, 30], spacing: [1, 2, 3], direction: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dims: [3, 3, 2] } as const;

const near = (found: Vector3, expected: readonly number[]) => found.toArray().forEach((n, axis) => expect(n).toBeCloseTo(expected[axis] ?? NaN, 12));

test("a sample is in the middle of its part of the texture, also in a block that is not full", () => {
  const { fromWorld, end } = placeInTexture(OVERVIEW, GRID);
  const at = (x: number, y: number, z: number) => {
    const world = new Vector3(...GRID.origin).addScaledVector(new Vector3(...GRID.direction[0]), x).addScaledVector(new Vector3(...GRID.direction[1]), 2 * y).addScaledVector(new Vector3(...GRID.direction[2]), 3 * z);
    return world.applyMatrix4(fromWorld);
  };
  // The first block has the samples 0 and 1, the second the sample 2.
  near(at(0.5, 0, 0), [0.25, 1 / 6, 0.25]);
  near(at(2, 2, 1), [0.625, 5 / 6, 0.75]);
  near(end, [0.75, 1, 1]);
});

test("values along uneven axes lie at even places", () => {
  const uneven = { origin: [0, 0, 0], spacing: [1, 1, 1], direction: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], dims: [2, 4, 1], positions: [null, [0, 2.9, 2.95, 3], null] } as const;
  const overview: Overview = { dims: [2, 4, 1], factors: [1, 1, 1], range: [0, 1], codes: Uint8Array.of(10, 11, 20, 21, 30, 31, 40, 41) };
  // A third of the way there is the first sample still, then the second one.
  expect([...evenCodes(overview, uneven)]).toEqual([10, 11, 10, 11, 20, 21, 40, 41]);
  expect(evenCodes(OVERVIEW, GRID)).toBe(OVERVIEW.codes);
  near(placeInTexture(overview, uneven).end, [1, 1, 1]);
});

test("planes keep their sides in another space", () => {
  const viewFrom = new Matrix4().makeRotationZ(0.7).setPosition(3, -2, 5).multiply(new Matrix4().makeScale(2, 3, 4));
  const plane = new Vector4(0.6, 0, 0.8, -1.5);
  const [found] = planesIn(viewFrom, [plane]);
  for (const place of [new Vector3(1, 2, 3), new Vector3(-4, 0.5, 0)]) {
    const inView = place.clone().applyMatrix4(viewFrom);
    const distance = (of: Vector4, at: Vector3) => of.dot(new Vector4(at.x, at.y, at.z, 1));
    expect(distance(found ?? plane, place)).toBeCloseTo(distance(plane, inView), 9);
  }
});

test("an answer that is not as long as it says is refused", () => {
  const header = JSON.stringify({ field: "depth", mode: "mean", dims: [2, 3, 2], factors: [2, 1, 1], range: [-1, 5] });
  expect(readOverview(header, OVERVIEW.codes.buffer)).toMatchObject({ dims: [2, 3, 2], range: [-1, 5] });
  expect(() => readOverview(header, new ArrayBuffer(11))).toThrow("an overview of 11 bytes, expected 2 × 3 × 2");
  expect(() => readOverview(null, new ArrayBuffer(11))).toThrow("do not say");
});

const withVolume = (of: Partial<Look["volume"]>): Look => ({ ...DEFAULT_LOOK, volume: { ...NO_VOLUME, mode: "maximum", ...of } });

test("a link has what differs", () => {
  const link = (look: Look) => encodeLink({ volume: "v", step: 0, surfaces: [SURFACE], selected: 0, opening: OPENING, look, openingLook: DEFAULT_LOOK, pose: undefined });
  expect(link(DEFAULT_LOOK)).not.toContain("vr");
  expect(link(withVolume({}))).toContain("vr=maximum");
  const look = withVolume({ mode: "rendering", opacity: 0.25, window: [-3, 8.5], windowField: "depth", marksIso: false });
  expect(link(look)).toContain("vr=rendering&vropacity=0.25&vrwindow=-3,8.5&vrfield=depth&vrmark=0");
  expect(decodeLink(link(look))?.look.volume).toEqual(look.volume);
  expect(decodeLink("volume=v")?.look).not.toHaveProperty("volume");
  expect(() => decodeLink("volume=v&vr=fog")).toThrow("expected one of off, maximum, rendering");
  expect(() => decodeLink("volume=v&vropacity=2")).toThrow("expected a number from 0 to 1");
  expect(() => decodeLink("volume=v&vrwindow=5,2")).toThrow("“vrwindow” is 5,2");
});

test("what is shown follows the surface, the window and the background", () => {
  expect(volumeWanted(DEFAULT_LOOK, volume, 0, SURFACE, "dark")).toBeUndefined();
  expect(volumeWanted(withVolume({}), volume, 0, undefined, "dark")).toBeUndefined();
  const of = (look: Look, theme: "dark" | "light" = "dark") => volumeWanted(look, volume, 2, SURFACE, theme);
  expect(of(withVolume({ window: [1, 2] }))).toMatchObject({ step: 2, field: OPENING.field, style: { isMaximum: true, window: [1, 2], iso: OPENING.iso } });
  // A window is about the field that it was chosen for.
  expect(of(withVolume({ window: [1, 2], windowField: OPENING.field }))?.style.window).toEqual([1, 2]);
  expect(of(withVolume({ window: [1, 2], windowField: "another" }))?.style.window).toEqual(of(withVolume({}))?.style.window);
  expect(of(withVolume({ marksIso: false }))?.style.iso).toBeUndefined();
  const ink = (look: Look, theme: "dark" | "light") => of(look, theme)?.style.ink;
  expect(ink(withVolume({}), "dark")).not.toBe(ink(withVolume({}), "light"));
  expect(ink({ ...withVolume({}), background: "white" }, "dark")).toBe(ink(withVolume({}), "light"));
  // Of an expression no histogram is known: the window is that of its overview.
  const computed = { ...SURFACE, view: { ...OPENING, field: "2*depth" } };
  expect(volumeWanted(withVolume({}), volume, 0, computed, "dark")?.style.window).toBeUndefined();
});

/** A shower with a server whose answers are given by hand. */
function showerOf() {
  const shown: (RayVolume | undefined)[] = [];
  const errors: string[] = [];
  const asked: (OverviewRequest & { readonly signal: AbortSignal; readonly answer: (overview: Overview) => Promise<void>; readonly refuse: (why: string) => Promise<void> })[] = [];
  const settle = () => new Promise<void>((done) => setTimeout(done, 0));
  const get = (_base: URL, request: OverviewRequest, signal: AbortSignal) =>
    new Promise<Overview>((resolve, reject) => {
      signal.addEventListener("abort", () => reject(new Error("aborted")));
      asked.push({ ...request, signal, answer: (overview) => (resolve(overview), settle()), refuse: (why) => (reject(new Error(why)), settle()) });
    });
  const shower = new VolumeShower((picture) => shown.push(picture), (reason) => errors.push(reason), new URL("http://127.0.0.1/"), get);
  const show = (look: Look, step = 0) => shower.show(volumeWanted(look, volume as NonNullable<typeof volume>, step, SURFACE, "dark"));
  return { show, shown, errors, asked, settle };
}

test("the volume is asked for once, and another look at it asks for nothing", async () => {
  const { show, shown, asked } = showerOf();
  show(withVolume({}));
  show(withVolume({ opacity: 0.3 }));
  expect(asked.map(({ mode, step, field }) => [mode, step, field])).toEqual([["maximum", 0, OPENING.field]]);
  await asked[0]?.answer(OVERVIEW);
  expect(shown.length).toBe(1);
  show(withVolume({ opacity: 0.3 }));
  expect(shown.length).toBe(1);
  show(withVolume({ opacity: 0.4 }));
  expect(shown.length).toBe(2);
  expect(shown[1]).toBe(shown[0]);
  show(withVolume({ mode: "off" }));
  expect(shown.at(-1)).toBeUndefined();
  show(withVolume({}));
  expect([shown.length, asked.length]).toEqual([4, 1]);
});

test("a step stays until the next one is there, and of many the latest is asked for", async () => {
  const { show, shown, asked, settle } = showerOf();
  show(withVolume({}));
  await asked[0]?.answer(OVERVIEW);
  show(withVolume({}), 1);
  show(withVolume({}), 2);
  expect(asked[1]?.signal.aborted).toBe(true);
  await settle();
  expect(asked.map(({ step }) => step)).toEqual([0, 1, 2]);
  expect(shown.length).toBe(1);
  await asked[2]?.answer(OVERVIEW);
  expect([shown.length, shown[1] === shown[0]]).toEqual([2, false]);
  // The other mode is another picture: nothing of this one stays.
  show(withVolume({ mode: "rendering" }), 2);
  expect(shown.at(-1)).toBeUndefined();
});

test("a refusal is said once, and asked again only for another choice", async () => {
  const { show, errors, asked } = showerOf();
  show(withVolume({}));
  await asked[0]?.refuse("6 overviews are being made");
  expect(errors).toEqual(["The volume cannot be shown: 6 overviews are being made"]);
  show(withVolume({ opacity: 0.2 }));
  expect(asked.length).toBe(1);
  show(withVolume({ mode: "off" }));
  show(withVolume({}));
  expect(asked.length).toBe(2);
});
