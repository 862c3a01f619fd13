import { expect, test } from "vitest";
import { readPlane, type Plane, type PlaneRequest } from "../src/net/slices";
import type { Slice } from "../src/scene/slices";
import { SliceLoader } from "../src/wiring/sliceLoader";
import { boundsOf, reach, usualWindow } from "../src/state/bounds";
import { NO_SLICES } from "../src/state/look";
import { VOLUMES } from "./fixture";

const header = (of: object) => JSON.stringify({ type: "i16", dims: [3, 2], missing: -1, origin: [1, 2, 3], steps: [[0, 1, 0], [0, 0, 2]], ...of });

test("samples of a slice are read as the header says, and what is missing is not a number", () => {
  const body = new DataView(new ArrayBuffer(12));
  [5, -1, 300, -300, 0, 7].forEach((value, i) => body.setInt16(2 * i, value, true));
  expect(readPlane(header({}), body.buffer)).toEqual({
    samples: new Float32Array([5, NaN, 300, -300, 0, 7]),
    size: [3, 2],
    origin: [1, 2, 3],
    right: [0, 1, 0],
    down: [0, 0, 2],
  });
  expect(readPlane(header({ type: "u8" }), new Uint8Array([1, 2, 3, 4, 5, 255]).buffer).samples[5]).toBe(255);
});

test("a missing value is found whatever its decimals, and so are values that are not finite", () => {
  const body = new DataView(new ArrayBuffer(24));
  [-1e34, 1, Infinity, NaN, -1e33, 2].forEach((value, i) => body.setFloat32(4 * i, value, true));
  expect([...readPlane(header({ type: "f32", missing: -1e34 }), body.buffer).samples].map(Number.isNaN)).toEqual([true, false, true, true, false, false]);
});

test("a slice that is not what it says is refused", () => {
  expect(() => readPlane(header({}), new ArrayBuffer(11))).toThrow("a slice of 11 bytes, expected 3 × 2 samples of 2");
  expect(() => readPlane(header({ type: "c64" }), new ArrayBuffer(12))).toThrow("type c64, expected one of u8");
  expect(() => readPlane(null, new ArrayBuffer(12))).toThrow("do not say what they are");
});

/** A loader whose requests are answered by hand. */
function loaderByHand() {
  const asked: { readonly request: PlaneRequest; readonly answer: (plane: Plane | Error) => void }[] = [];
  const shown: (readonly Slice[])[] = [];
  const errors: string[] = [];
  const loader = new SliceLoader(
    (slices) => shown.push(slices),
    (reason) => errors.push(reason),
    new URL("http://server/"),
    (_, request) => new Promise((found, failed) => asked.push({ request, answer: (plane) => (plane instanceof Error ? failed(plane) : found(plane)) })),
  );
  const settle = () => new Promise((done) => setTimeout(done, 0));
  return { loader, asked, shown, errors, settle };
}

const [volume, other] = VOLUMES;
if (volume === undefined || other === undefined) throw new Error("two volumes expected");
const source = { volume, step: 0, field: "depth" };
const plane: Plane = { samples: new Float32Array(1), size: [1, 1], origin: [0, 0, 0], right: [1, 0, 0], down: [0, 1, 0] };
const across = (x: number | null, window?: readonly [number, number]) => ({ planes: [x, null, null], window }) as const;

test("while a slider is dragged one request is on its way, and the last place is shown", async () => {
  const { loader, asked, shown, settle } = loaderByHand();
  for (const index of [3, 4, 5, 6]) loader.show(across(index, [0, 2]), source);
  expect(asked.map(({ request }) => request.index)).toEqual([3]);
  asked[0]?.answer(plane);
  await settle();
  expect(asked.map(({ request }) => request.index)).toEqual([3, 6]);
  expect(shown).toEqual([]);
  asked[1]?.answer(plane);
  await settle();
  expect(shown.map((slices) => slices.map(({ window }) => window))).toEqual([[[0, 2]]]);
});

test("window and level ask for nothing, and an index past the end is the last one", async () => {
  const { loader, asked, shown, settle } = loaderByHand();
  loader.show(across(9999), source);
  expect(asked[0]?.request.index).toBe(volume.geometry.dims[0] - 1);
  asked[0]?.answer(plane);
  await settle();
  loader.show(across(9999, [1, 3]), source);
  loader.show(across(9999, [1, 3]), source);
  expect([asked.length, shown.length]).toEqual([1, 2]);
  expect(shown[1]?.[0]?.window).toEqual([1, 3]);
});

test("slices of the volume before are gone at once, and those that are off", async () => {
  const { loader, asked, shown, settle } = loaderByHand();
  loader.show(across(3), source);
  asked[0]?.answer(plane);
  await settle();
  loader.show(NO_SLICES, { ...source, volume: other });
  await settle();
  expect(shown.map((slices) => slices.length)).toEqual([1, 0]);
  expect(asked.length).toBe(1);
});

test("what cannot be shown is said, and asked for again when something changes", async () => {
  const { loader, asked, errors, settle } = loaderByHand();
  loader.show(across(3), source);
  asked[0]?.answer(new Error("the server is busy"));
  await settle();
  expect(errors).toEqual(["The slices cannot be shown: the server is busy"]);
  loader.show(across(4), source);
  expect(asked.length).toBe(2);
});

test("a volume's box in the world, however its axes lie", () => {
  const geometry = {
    dims: [3, 5, 2],
    spacing: [2, 1, 10],
    origin: [1, 1, 1],
    direction: [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
    frame: "world",
    unit: null,
  } as const;
  const bounds = boundsOf(geometry);
  expect(bounds).toEqual({ min: [-3, 1, 1], max: [1, 11, 5] });
  expect(reach(bounds, [0, 0, -1])).toEqual([-5, -1]);
  expect(reach(bounds, [0.6, 0.8, 0])).toEqual([0.6 * -3 + 0.8, 0.6 + 0.8 * 11]);
});

test("of an expression the window is that of what is shown", async () => {
  const { loader, asked, shown, settle } = loaderByHand();
  loader.show(across(1), { ...source, field: "2 * depth" });
  expect(asked[0]?.request.field).toBe("2 * depth");
  asked[0]?.answer({ ...plane, samples: Float32Array.from([3, NaN, -2, 7]), size: [2, 2] });
  await settle();
  expect(shown.at(-1)?.map(({ window }) => window)).toEqual([[-2, 7]]);
});

test("slices are as bright as most values are, whatever single ones are", () => {
  const of = (counts: readonly number[]) => {
    const fields = volume.fields.map((field) => ({ ...field, histogram: { min: 0, max: counts.length, counts } }));
    return usualWindow({ ...volume, fields }, source.field);
  };
  // Tissue, bone, and a screw.
  expect(of([0, 500, 400, 100, 0, 0, 0, 0, 0, 2])).toEqual([1, 4]);
  expect(of([3, 500, 400, 100, 0, 0, 0, 0, 0, 2])).toEqual([1, 4]);
  // A mask, even of a few samples, and all values alike.
  expect([of([90, 0, 0, 10]), of([9999, 0, 0, 1]), of([0, 0])]).toEqual([[0, 4], [0, 4], [0, 2]]);
});
