import { describe, expect, test } from "vitest";
import { joinGlb, type GlbPart } from "../src/net/glb";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { NOTHING_KNOWN } from "./acting";
import { linearColor } from "../src/transfer/model";
import { colorOf, signOf } from "../src/wiring/surfaceSigns";
import { OPENING, VOLUMES } from "./fixture";

interface Gltf {
  asset: { generator: string };
  scenes: { nodes?: number[] }[];
  nodes: { name: string; mesh: number; extras?: unknown }[];
  meshes: { name: string; primitives: { attributes: Record<string, number>; indices: number; material: number; extras?: unknown }[] }[];
  materials: { name: string; pbrMetallicRoughness: object; alphaMode?: string; doubleSided: boolean }[];
  accessors: { bufferView: number; byteOffset: number; count: number }[];
  bufferViews: { byteOffset: number; byteLength: number }[];
  buffers: { byteLength: number }[];
}

/** What turns positions into metres, Y up. */
const PLACED = { rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2], scale: [1e-3, 1e-3, 1e-3] };

/** A GLB of one mesh with two primitives, as the server writes it: positions and colours of three vertices, then indices. Bytes are all `fill`. */
function file(fill: number, hasMesh = true): ArrayBuffer {
  const views = [
    { buffer: 0, byteOffset: 0, byteLength: 36, target: 34962 },
    { buffer: 0, byteOffset: 36, byteLength: 24, target: 34962 },
    { buffer: 0, byteOffset: 60, byteLength: 24, target: 34963 },
  ];
  const accessor = (bufferView: number, byteOffset: number, more: object) => ({ bufferView, byteOffset, count: 3, ...more });
  const attributes = { POSITION: 0, COLOR_0: 1 };
  const mesh = {
    scenes: [{ nodes: [0] }],
    nodes: [{ name: "isosurface", mesh: 0, ...PLACED }],
    meshes: [{ primitives: [2, 3].map((indices) => ({ attributes, indices, material: 0, mode: 4, extras: { level: indices } })) }],
    materials: [{ name: "matt", pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.8 }, doubleSided: true }],
    accessors: [accessor(0, 0, { type: "VEC3" }), accessor(1, 0, { type: "VEC4" }), accessor(2, 0, { type: "SCALAR" }), accessor(2, 12, { type: "SCALAR" })],
    bufferViews: views,
    buffers: [{ byteLength: 84 }],
  };
  const document = { asset: { version: "2.0", generator: "isopeel 1", extras: { triangles: fill } }, scene: 0, ...(hasMesh ? mesh : { scenes: [{ name: "empty" }] }) };
  const text = JSON.stringify(document);
  const json = new TextEncoder().encode(text.padEnd(4 * Math.ceil(text.length / 4)));
  const binary = hasMesh ? 84 : 0;
  const bytes = new Uint8Array(20 + json.length + (hasMesh ? 8 + binary : 0)).fill(fill);
  const view = new DataView(bytes.buffer);
  [0x46546c67, 2, bytes.length, json.length, 0x4e4f534a].forEach((word, i) => view.setUint32(4 * i, word, true));
  bytes.set(json, 20);
  if (hasMesh) [binary, 0x004e4942].forEach((word, i) => view.setUint32(20 + json.length + 4 * i, word, true));
  return bytes.buffer;
}

async function read(blob: Blob): Promise<{ gltf: Gltf; binary: Uint8Array }> {
  const bytes = await blob.arrayBuffer();
  const view = new DataView(bytes);
  expect(view.getUint32(8, true)).toBe(bytes.byteLength);
  const length = view.getUint32(12, true);
  expect(length % 4).toBe(0);
  const gltf = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 20, length))) as Gltf;
  return { gltf, binary: new Uint8Array(bytes.slice(Math.min(bytes.byteLength, 28 + length))) };
}

const part = (name: string, of: Partial<GlbPart> = {}): GlbPart => ({ name, color: undefined, opacity: 1, file: file(Number(name)), ...of });

describe("GLB files of several surfaces", () => {
  test("become one, with a node and a material each", async () => {
    const { gltf, binary } = await read(joinGlb([part("7"), part("90", { color: [1, 0.5, 0], opacity: 0.35 })]));
    expect(gltf.asset).toEqual({ version: "2.0", generator: "isopeel 1" });
    expect(gltf.scenes).toEqual([{ nodes: [0, 1] }]);
    expect(gltf.nodes).toEqual([{ name: "7", mesh: 0, ...PLACED, extras: { triangles: 7 } }, { name: "90", mesh: 1, ...PLACED, extras: { triangles: 90 } }]);
    expect(gltf.materials).toEqual([
      { name: "7", pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.8, baseColorFactor: [1, 1, 1, 1] }, doubleSided: true },
      { name: "90", pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.8, baseColorFactor: [1, 0.5, 0, 0.35] }, doubleSided: true, alphaMode: "BLEND" },
    ]);
    expect(gltf.meshes.flatMap(({ primitives }) => primitives.map(({ material }) => material))).toEqual([0, 0, 1, 1]);
    expect(gltf.meshes[1]!.primitives[1]!.extras).toEqual({ level: 3 });
    // Each surface refers to its own bytes.
    expect(gltf.buffers).toEqual([{ byteLength: binary.length }]);
    for (const [mesh, fill] of [[0, 7], [1, 90]] as const)
      for (const { attributes, indices } of gltf.meshes[mesh]!.primitives)
        for (const number of [...Object.values(attributes), indices]) {
          const { byteOffset, byteLength } = gltf.bufferViews[gltf.accessors[number]!.bufferView]!;
          expect(byteOffset % 4).toBe(0);
          expect(new Set(binary.slice(byteOffset, byteOffset + byteLength))).toEqual(new Set([fill]));
        }
  });

  test("leave out the vertices' colours, and their bytes, where a surface has its own", async () => {
    const { gltf, binary } = await read(joinGlb([part("7"), part("90", { color: [1, 1, 1] })]));
    expect(gltf.meshes.map(({ primitives }) => Object.keys(primitives[0]!.attributes))).toEqual([["POSITION", "COLOR_0"], ["POSITION"]]);
    expect([gltf.accessors.length, gltf.bufferViews.length, binary.length]).toEqual([7, 5, 84 + 60]);
  });

  test("may be empty, and have to be whole", async () => {
    const { gltf } = await read(joinGlb([part("7", { file: file(7, false) }), part("8")]));
    expect(gltf.nodes.map(({ name }) => name)).toEqual(["8"]);
    const none = await read(joinGlb([part("7", { file: file(7, false) })]));
    expect([none.gltf.scenes, none.gltf.nodes, none.binary.length]).toEqual([[{ name: "no isosurface" }], undefined, 0]);
    for (const length of [0, 11, 19, 200]) expect(() => joinGlb([part("7", { file: file(7).slice(0, length) })])).toThrow(`7: ${length} bytes that are no whole GLB of version 2`);
  });
});

test("a surface's colour is its own, else the material's, unless the vertices have the transfer function's", () => {
  const look = { ...DEFAULT_LOOK, colorBy: "material", material: "clay" } as const;
  const clay = colorOf({ style: DEFAULT_STYLE }, look);
  expect(clay).toMatch(/^#[0-9a-f]{6}$/);
  expect(colorOf({ style: DEFAULT_STYLE }, { ...look, colorBy: "transfer" })).toBeUndefined();
  expect(colorOf({ style: DEFAULT_STYLE }, { ...look, colorBy: "level" })).toBe(clay);
  expect(colorOf({ style: { ...DEFAULT_STYLE, color: "#102030" } }, { ...look, colorBy: "transfer" })).toBe("#102030");
  expect(linearColor("#ff0000")).toEqual([1, 0, 0]);
  expect(linearColor("#80ff0a")[0]).toBeCloseTo(0.2159, 4);
  expect(linearColor("#80ff0a")[2]).toBeCloseTo(10 / 255 / 12.92, 9);
});

test("the sign of a surface in images has its colours and its isovalue with the unit", () => {
  const volume = VOLUMES[0]!;
  const field = { ...volume.fields[0]!, unit: "HU" };
  const viewer = { ...NOTHING_KNOWN, volume: { ...volume, fields: [field] } };
  const surface = { number: 0, view: { ...OPENING, field: field.name, iso: 517.25 }, style: { ...DEFAULT_STYLE, opacity: 0.35, color: "#e08a5b" } };
  const store = { look: DEFAULT_LOOK, surfaces: [surface], viewer };
  expect(signOf(surface, store)).toEqual({ stops: ["#e08a5b"], opacity: 0.35, text: `${field.name} 517.25 HU` });
  const mapped = signOf({ ...surface, style: DEFAULT_STYLE }, { ...store, look: { ...DEFAULT_LOOK, colorBy: "importance" } });
  expect(mapped.stops.length).toBeGreaterThan(4);
  expect(signOf({ ...surface, style: DEFAULT_STYLE }, { ...store, look: { ...DEFAULT_LOOK, colorBy: "material" } }).stops).toHaveLength(1);
});
