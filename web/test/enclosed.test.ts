import { MeshoptDecoder } from "meshoptimizer/decoder";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { beforeAll, describe, expect, test, vi } from "vitest";
import { MeshSummation, type SummedMesh } from "../src/decode/meshSums";
import { DecodeService, type DecodeReply } from "../src/decode/service";
import type { Vec3 } from "../src/protocol/types";
import { enclosedOf } from "../src/state/enclosed";
import { lengthScale, lengthUnit, unitWord } from "../src/state/lengths";
import { NOTHING_KNOWN } from "./acting";
import type { ViewerState } from "../src/state/viewer";
import { enclosedNote, enclosedRows } from "../src/ui/cards/enclosedWords";
import { formatLength } from "../src/ui/format";
import { errorWords } from "../src/ui/words";
import { axesOf, Enclosing } from "../src/wiring/summing";
import { statistics, VOLUMES } from "./fixture";
import { encodeChunk, surfaceNets, type Field } from "./synthetic";

const UNIT: [Vec3, Vec3, Vec3] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const LATTICE = 64;

/** A mesh of triangles between places in index space, each corner a vertex of its own or shared by place. */
function meshOf(triangles: readonly (readonly [Vec3, Vec3, Vec3])[], region: Vec3 = [0, 0, 0], shares = true): SummedMesh {
  const numbers = new Map<string, number>();
  const words: number[] = [];
  const indices = triangles.flat().map((place, i) => {
    const key = shares ? place.join() : String(i);
    const known = numbers.get(key);
    if (known !== undefined) return known;
    numbers.set(key, numbers.size);
    words.push(...place.map((n, axis) => (n - 32 * region[axis]!) * LATTICE), 0, 0, 0);
    return numbers.size - 1;
  });
  return { vertices: Int16Array.from(words), indices: Uint16Array.from(indices), region, lattice: LATTICE };
}

/** The twelve triangles of a box, counter-clockwise from outside; `inwards` from inside. */
function box(low: Vec3, high: Vec3, inwards = false): [Vec3, Vec3, Vec3][] {
  const corner = (i: number): Vec3 => [(i & 1 ? high : low)[0], (i & 2 ? high : low)[1], (i & 4 ? high : low)[2]];
  const faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] as const;
  return faces.flatMap(([a, b, c, d]) =>
    ([[a, b, c], [a, c, d]] as const).map(([i, j, k]): [Vec3, Vec3, Vec3] => (inwards ? [corner(i), corner(k), corner(j)] : [corner(i), corner(j), corner(k)])),
  );
}

function sumsOf(meshes: readonly SummedMesh[], axes = UNIT) {
  const summation = new MeshSummation(axes);
  for (const mesh of meshes) summation.add(mesh);
  return summation.sums;
}

describe("area and volume of a surface", () => {
  test("of a box are those of its sides, in the world", () => {
    expect(sumsOf([meshOf(box([3, 4, 5], [5, 7, 9.5]))])).toEqual({ area: 2 * (2 * 3 + 3 * 4.5 + 2 * 4.5), volume: 27, borderEdges: 0 });
    const axes: [Vec3, Vec3, Vec3] = [[0, 2, 0], [3, 0, 0], [0, 0, 0.5]];
    const { area, volume } = sumsOf([meshOf(box([3, 4, 5], [5, 7, 9.5]))], axes);
    expect(area).toBeCloseTo(2 * (4 * 9 + 9 * 2.25 + 4 * 2.25), 9);
    // A mirrored world turns nothing inside out.
    expect(volume).toBeCloseTo(4 * 9 * 2.25, 9);
  });

  test("do not depend on how the surface is cut in regions, or on whether vertices are shared", () => {
    const all = box([30, 30, 30], [34, 35, 36]);
    const [some, others] = [all.filter((_, i) => i % 3 === 0), all.filter((_, i) => i % 3 !== 0)];
    for (const shares of [true, false]) {
      // The last one has the low corner of a region of size 2.
      for (const region of [[1, 1, 0], [4, 0, 4]] as const) {
        const sums = sumsOf([meshOf(some, [0, 0, 0], shares), meshOf(others, region, shares)]);
        expect(sums).toEqual({ area: 2 * (20 + 30 + 24), volume: 120, borderEdges: 0 });
      }
    }
  });

  test("of a plane: it is open, at each edge around it", () => {
    const plane: [Vec3, Vec3, Vec3][] = [[[0, 0, 5], [4, 0, 5], [4, 3, 5]], [[0, 0, 5], [4, 3, 5], [0, 3, 5]]];
    expect(sumsOf([meshOf(plane)])).toMatchObject({ area: 12, borderEdges: 4 });
    expect(sumsOf(plane.map((triangle) => meshOf([triangle])))).toMatchObject({ area: 12, borderEdges: 4 });
    expect(sumsOf([meshOf(box([1, 1, 1], [2, 2, 2]).slice(1))]).borderEdges).toBe(3);
  });

  test("two triangles that turn different sides outwards do not close each other", () => {
    const [first, second] = box([0, 0, 0], [2, 2, 2]);
    expect(sumsOf([meshOf([first!, [second![0], second![2], second![1]]])]).borderEdges).toBe(6);
  });

  test("a cavity is taken away, a surface around lower values is negative", () => {
    const shell = sumsOf([meshOf([...box([0, 0, 0], [10, 10, 10]), ...box([2, 2, 2], [5, 5, 5], true)])]);
    expect(shell).toEqual({ area: 600 + 54, volume: 973, borderEdges: 0 });
    expect(sumsOf([meshOf(box([2, 2, 2], [5, 5, 5], true))]).volume).toBe(-27);
  });

  test("an edge of four triangles is none of the border, and one of no length neither", () => {
    const touching = [...box([0, 0, 0], [2, 2, 2]), ...box([2, 2, 0], [4, 4, 2])];
    expect(sumsOf([meshOf(touching)])).toEqual({ area: 48, volume: 16, borderEdges: 0 });
    const flat: [Vec3, Vec3, Vec3] = [[0, 0, 0], [0, 0, 0], [2, 0, 0]];
    expect(sumsOf([meshOf([...box([0, 0, 0], [2, 2, 2]), flat], [0, 0, 0], false)])).toEqual({ area: 24, volume: 8, borderEdges: 0 });
  });
});

const BALL: Field = (x, y, z) => 21.3 - Math.hypot(x - 32.2, y - 31.7, z - 32.4);

/** What the worker answers, in order. */
function service() {
  const replies: DecodeReply[] = [];
  const worker = new DecodeService(MeshoptDecoder, (reply) => replies.push(reply));
  const sum = (ids: readonly number[], ticket = 1) => worker.receive({ type: "sum", ticket, ids, axes: UNIT });
  return { replies, worker, sum };
}

describe("the worker", () => {
  beforeAll(() => Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]));

  test("sums up a ball over eight regions from their chunks", async () => {
    const { replies, worker, sum } = service();
    const meshes = surfaceNets(BALL, 0, 0);
    expect(meshes.length).toBeGreaterThanOrEqual(8);
    meshes.forEach((mesh, id) => worker.receive({ type: "decode", id, frame: encodeChunk(mesh, 1, 0).buffer }));
    sum(meshes.map((_, id) => id));
    await vi.waitFor(() => expect(replies.at(-1)?.type).toBe("summed"));
    const { area, volume, borderEdges } = replies.flatMap((reply) => (reply.type === "summed" ? [reply.sums] : []))[0]!;
    expect(borderEdges).toBe(0);
    expect(volume / ((4 / 3) * Math.PI * 21.3 ** 3)).toBeCloseTo(1, 2);
    expect(area / (4 * Math.PI * 21.3 ** 2)).toBeCloseTo(1, 2);
    // Without one of its regions the ball is open.
    sum(meshes.slice(1).map((_, id) => id + 1));
    await vi.waitFor(() => expect(replies.filter(({ type }) => type === "summed")).toHaveLength(2));
    expect(replies.flatMap((reply) => (reply.type === "summed" ? [reply.sums.borderEdges] : [])).at(-1)).toBeGreaterThan(20);
  });

  test("keeps what is in use alone, and says which chunk it has not", async () => {
    const { replies, worker, sum } = service();
    const [mesh] = surfaceNets(BALL, 0, 2);
    for (const id of [3, 4]) worker.receive({ type: "decode", id, frame: encodeChunk(mesh!, 1, 0).buffer });
    // What is forgotten while it is summed up is in the sum.
    sum([3, 4]);
    worker.receive({ type: "forget", ids: [3] });
    sum([3, 4], 2);
    await vi.waitFor(() => expect(replies.map(({ type }) => type).sort()).toEqual(["decoded", "decoded", "summed", "unsummed"]));
    expect(replies).toContainEqual({ type: "unsummed", ticket: 2, error: "chunk 3 is not there any more" });
  });
});

describe("the page", () => {
  const base = { area: 10, volume: 5, borderEdges: 0 };
  const shown = { generation: 1, level: 0, final: true };
  function enclosing(pipelineSum: () => Promise<typeof base>) {
    const store: { viewer: ViewerState } = { viewer: { ...NOTHING_KNOWN, volume: VOLUMES[0], shown } };
    const said: unknown[] = [];
    const toasts: string[] = [];
    const sum = vi.fn(pipelineSum);
    return { enclosing: new Enclosing(store, (what) => said.push(what), (reason) => toasts.push(reason), { sum }), said, store, sum, toasts };
  }

  test("shows sums while their surface is on screen", async () => {
    const { enclosing: of, said, store, sum } = enclosing(() => Promise.resolve(base));
    await of.sum();
    expect(said).toEqual(["summing", { area: 10, volume: 5, borderEdges: 0 }]);
    expect(sum).toHaveBeenCalledWith(0, axesOf(VOLUMES[0]!.geometry), undefined);
    of.follow();
    expect(said).toHaveLength(2);
    store.viewer = { ...store.viewer, shown: { ...shown, generation: 2 } };
    of.follow();
    expect(said.at(-1)).toBeUndefined();
  });

  test("sums up the better surface that follows at rest, and shows the numbers of no other", async () => {
    const answers: ((sums: typeof base) => void)[] = [];
    const { enclosing: of, said, store, sum } = enclosing(() => new Promise((found) => answers.push(found)));
    void of.sum();
    store.viewer = { ...store.viewer, shown: { ...shown } };
    of.follow();
    expect(sum).toHaveBeenCalledTimes(2);
    answers[1]!({ ...base, area: 11 });
    answers[0]!(base);
    await vi.waitFor(() => expect(said).toEqual(["summing", "summing", { ...base, area: 11 }]));
    // A late answer of a surface that an edit has replaced.
    void of.sum();
    store.viewer = { ...store.viewer, shown: { ...shown, generation: 3 } };
    of.follow();
    answers[2]!(base);
    await Promise.resolve();
    expect(said.slice(3)).toEqual(["summing", undefined]);
  });

  test("says what failed", async () => {
    const { enclosing: failing, said, toasts } = enclosing(() => Promise.reject(new Error("chunk 3 is not there any more")));
    await failing.sum();
    expect(said).toEqual(["summing", undefined]);
    expect(toasts).toEqual(["Area and volume could not be summed up: chunk 3 is not there any more"]);
  });

  test("says them with their unit, and why there is no volume", () => {
    expect(enclosedRows(enclosedOf({ area: 1234.56, volume: 123456.7, borderEdges: 0 }), "mm")).toEqual([["Area", "1,235 mm²"], ["Enclosed volume", "123,500 mm³"]]);
    expect(enclosedRows(enclosedOf({ area: 0.5, volume: -27, borderEdges: 0 }), undefined)).toEqual([["Area", "0.5 world units²"], ["Enclosed, of lower values", "27 world units³"]]);
    const open = enclosedOf({ area: 12, volume: 7, borderEdges: 1204 });
    expect(enclosedRows(open, "m")).toEqual([["Area", "12 m²"], ["Enclosed volume", "none, it is open"]]);
    expect(enclosedNote(open, "error 0.1 voxels (RMS)")).toBe(
      "The surface ends at 1,204 edges: at the volume's faces, at missing samples, or at cracks. Of the mesh on screen, with what is clipped or peeled away; error 0.1 voxels (RMS).",
    );
    expect(enclosedNote(enclosedOf(base), undefined)).toBe("Of the mesh on screen, with what is clipped or peeled away.");
  });

  test("knows the unit where the volume has one", () => {
    const { geometry } = VOLUMES[0]!;
    expect(lengthUnit({ geometry })).toBeUndefined();
    expect(lengthUnit({ geometry: { ...geometry, unit: " " } })).toBeUndefined();
    expect(lengthUnit({ geometry: { ...geometry, unit: "mm" } })).toBe("mm");
    expect([unitWord("mm"), unitWord(undefined, 2)]).toEqual(["mm", "world units²"]);
    expect(lengthScale({ geometry: { ...geometry, spacing: [2, 0.5, 1], unit: "mm" } })).toEqual({ spacing: 0.5, unit: "mm" });
    const scale = { spacing: 0.5, unit: "mm" };
    expect([formatLength(0.1234, scale), formatLength(0.1234, { ...scale, unit: undefined })]).toEqual(["0.12 mm", "0.25 voxels"]);
    expect(errorWords([{ ...statistics(100), error: { rms: 0.041, max: 0.1 } }], scale)).toBe("error 0.041 mm (RMS)");
  });
});
