import { MeshoptDecoder } from "meshoptimizer/decoder";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { beforeAll, describe, expect, test } from "vitest";
import { decodeChunk } from "../src/decode/decode";
import { FAR_AWAY, readDistances } from "../src/decode/distances";
import { ChunkError, HEADER_BYTES, MAX_INDICES, MAX_VERTICES, readChunkHeader } from "../src/protocol/chunk";
import { encodeChunk, encodeDistances, octahedral, surfaceNets, wobblyBall, type SyntheticMesh } from "./synthetic";

let mesh: SyntheticMesh;
let frame: Uint8Array<ArrayBuffer>;

beforeAll(async () => {
  await Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]);
  const found = surfaceNets(wobblyBall(0), 0, 1)[3];
  if (found === undefined) throw new Error("the synthetic surface has no fourth region");
  mesh = found;
  frame = encodeChunk(mesh, 7, 2);
});

/** A copy with some bytes changed. */
function tampered(change: (view: DataView) => void): ArrayBuffer {
  const copy = frame.slice().buffer;
  change(new DataView(copy));
  return copy;
}

describe("header", () => {
  test("has the values that were written", () => {
    const header = readChunkHeader(frame.buffer);
    expect(header).toMatchObject({
      generation: 7,
      level: 2,
      surface: 0,
      lattice: 256,
      region: mesh.region,
      size: 0,
      vertexCount: mesh.positions.length / 3,
      indexCount: mesh.indices.length,
      levelTriangles: mesh.levelTriangles,
    });
    expect(header.vertexBytes + header.indexBytes + HEADER_BYTES).toBe(frame.byteLength);
  });

  test("of a region without surface is read", () => {
    const empty = { ...mesh, positions: [], normals: [], s: [], f: [], indices: [], levelTriangles: [0, 0, 0, 0, 0, 0] };
    const header = readChunkHeader(encodeChunk(empty, 1, 0).buffer);
    expect(header).toMatchObject({ vertexCount: 0, indexCount: 0, vertexBytes: 0, indexBytes: 0 });
  });

  test.each([
    [1, [2, 0, 4]],
    [2, [4, 0, 8]],
  ] as const)("of a region of size %d is read", (size, region) => {
    const positions = mesh.positions.map((p, i) => p + 32 * (region[(i % 3) as 0 | 1 | 2] - mesh.region[(i % 3) as 0 | 1 | 2]));
    const large = encodeChunk({ ...mesh, positions, region, size }, 3, 0);
    new DataView(large.buffer).setUint16(16, 64, true);
    expect(readChunkHeader(large.buffer)).toMatchObject({ region, size });
    const { vertices } = decodeChunk(MeshoptDecoder, readChunkHeader(large.buffer), large.buffer);
    expect(vertices).toEqual(decodeChunk(MeshoptDecoder, readChunkHeader(frame.buffer), frame.buffer).vertices);
  });

  test("every cut-off frame is refused", () => {
    for (let length = 0; length < frame.byteLength; length += length < 120 ? 1 : 97) {
      expect(() => readChunkHeader(frame.slice(0, length).buffer), `${length} bytes`).toThrow(ChunkError);
    }
  });

  test("one byte too many is refused", () => {
    const longer = new Uint8Array(frame.byteLength + 1);
    longer.set(frame);
    expect(() => readChunkHeader(longer.buffer)).toThrow(/the frame has/);
  });

  test.each([
    ["magic", (v: DataView) => v.setUint8(0, 0x49 ^ 1), /magic/],
    ["version", (v: DataView) => v.setUint16(4, 2, true), /version 2, .*reload/],
    ["header length", (v: DataView) => v.setUint16(6, 104, true), /header length 104/],
    ["level", (v: DataView) => v.setUint8(12, 6), /level 6, expected 0 to 5/],
    ["kind", (v: DataView) => v.setUint8(13, 2), /kind 2, expected 0 .cut. or 1 .error./],
    ["payload of an annotation", (v: DataView) => (v.setUint8(12, 0), v.setUint8(13, 1)), /vertices in payloads of/],
    ["level of an annotation", (v: DataView) => v.setUint8(13, 1), /kind 1 .error. of level 2, expected 0/],
    ["surface", (v: DataView) => v.setUint8(14, 4), /surface 4, expected 0 to 3/],
    ["flags", (v: DataView) => v.setUint8(15, 4), /flags 4/],
    ["coding", (v: DataView) => v.setUint8(15, 1), /vertices in payloads of/],
    ["coding of an annotation", (v: DataView) => (v.setUint8(12, 0), v.setUint8(13, 1), v.setUint8(15, 1)), /flags 1 of kind error/],
    ["size", (v: DataView) => v.setUint16(18, 3, true), /region size 3, expected 0 to 2/],
    ["size of two bytes", (v: DataView) => v.setUint16(18, 256, true), /region size 256, expected 0 to 2/],
    ["place", (v: DataView) => (v.setUint16(18, 1, true), v.setUint32(24, 3, true)), /of size 1, expected multiples of 2/],
    ["lattice of a large region", (v: DataView) => (v.setUint16(18, 2, true), [20, 24, 28].forEach((at) => v.setUint32(at, 4, true))), /256 lattice units per cell, expected 1 to 255/],
    ["lattice 0", (v: DataView) => v.setUint16(16, 0, true), /lattice/],
    ["lattice past 16 bits", (v: DataView) => v.setUint16(16, 1024, true), /lattice/],
    ["bounds", (v: DataView) => v.setFloat32(32, NaN, true), /bounds/],
    ["bounds in disorder", (v: DataView) => v.setFloat32(32, 1e6, true), /bounds/],
    ["vertices", (v: DataView) => v.setUint32(56, MAX_VERTICES + 1, true), /vertices, expected at most/],
    ["no vertices", (v: DataView) => v.setUint32(56, 0, true), /0 vertices with/],
    ["indices", (v: DataView) => v.setUint32(60, MAX_INDICES + 3, true), /indices, expected at most/],
    ["indices not by 3", (v: DataView) => v.setUint32(60, v.getUint32(60, true) + 1, true), /multiple of 3/],
    ["payload", (v: DataView) => v.setUint32(64, 0xffffffff, true), /the frame has/],
    ["levels", (v: DataView) => v.setUint32(72, v.getUint32(72, true) + 1, true), /levels add up to/],
  ])("wrong %s is refused", (_, change, message) => {
    const bad = tampered(change);
    expect(() => readChunkHeader(bad)).toThrow(ChunkError);
    expect(() => readChunkHeader(bad)).toThrow(message);
  });
});

describe("distances", () => {
  test("are read in the order of their vertices; infinite ones become numbers", () => {
    const sent = mesh.positions.filter((_, i) => i % 3 === 0).map((x, i) => (i === 5 ? Infinity : Math.fround(x)));
    const chunk = encodeDistances(mesh, sent, 9).buffer;
    const header = readChunkHeader(chunk);
    expect(header).toMatchObject({ kind: "error", generation: 9, level: 0, region: mesh.region, vertexCount: sent.length });
    expect([...readDistances(header, chunk)]).toEqual(sent.map((d) => (d === Infinity ? Math.fround(FAR_AWAY) : d)));
  });

  test.each([NaN, -1])("%d is refused", (wrong) => {
    const chunk = encodeDistances(mesh, mesh.s.map((_, i) => (i === 3 ? wrong : 0)), 9).buffer;
    expect(() => readDistances(readChunkHeader(chunk), chunk)).toThrow(/distance (NaN|-1) of vertex 3, expected 0 or more/);
  });
});

describe("decoding", () => {
  test("gives back positions, normals, features and triangles", () => {
    const header = readChunkHeader(frame.buffer);
    const { vertices, indices } = decodeChunk(MeshoptDecoder, header, frame.buffer);
    expect(indices).toBeInstanceOf(Uint16Array);
    expect(indices.length).toBe(mesh.indices.length);
    const bytes = new DataView(vertices.buffer);
    // The decoder may rotate a triangle's corners; order of triangles and winding are kept.
    for (let i = 0; i < indices.length; i += 3) {
      const sent = mesh.indices.slice(i, i + 3);
      const got = [...indices.slice(i, i + 3)];
      const offset = sent.indexOf(got[0]!);
      expect(got).toEqual([0, 1, 2].map((c) => sent[(offset + c) % 3]));
    }
    for (let v = 0; v < header.vertexCount; v += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        const index = 32 * header.region[axis]! + bytes.getInt16(12 * v + 2 * axis, true) / 256;
        expect(Math.abs(index - mesh.positions[3 * v + axis]!)).toBeLessThanOrEqual(0.5 / 256 + 1e-6);
      }
      const normal = [0, 1, 2].map((axis) => mesh.normals[3 * v + axis]!) as [number, number, number];
      expect([bytes.getInt8(12 * v + 6), bytes.getInt8(12 * v + 7)]).toEqual(octahedral(normal).map((x) => x + 0));
      expect(bytes.getUint16(12 * v + 8, true)).toBe(Math.round(mesh.s[v]! * 65535));
      expect(bytes.getUint16(12 * v + 10, true)).toBe(Math.round(mesh.f[v]! * 65535));
    }
  });

  test("an index without a vertex is refused", () => {
    const lying = { ...mesh, indices: [...mesh.indices] };
    lying.indices[4] = mesh.positions.length / 3;
    const bad = encodeChunk(lying, 1, 0);
    const header = readChunkHeader(bad.buffer);
    expect(() => decodeChunk(MeshoptDecoder, header, bad.buffer)).toThrow(/expected below/);
  });

  test("damaged payloads are refused", () => {
    const header = readChunkHeader(frame.buffer);
    const noVertices = tampered((v) => v.setUint8(HEADER_BYTES, 0));
    expect(() => decodeChunk(MeshoptDecoder, header, noVertices)).toThrow(/damaged payload/);
    const noIndices = tampered((v) => v.setUint8(HEADER_BYTES + header.vertexBytes, 0));
    expect(() => decodeChunk(MeshoptDecoder, header, noIndices)).toThrow(/damaged payload/);
  });

  test("noise in the payload never gives an index without a vertex", () => {
    const header = readChunkHeader(frame.buffer);
    let seed = 1;
    const random = () => (seed = (seed * 48271) % 0x7fffffff);
    let refused = 0;
    for (let round = 0; round < 200; round += 1) {
      const noisy = tampered((v) => {
        for (let i = 0; i < 8; i += 1) v.setUint8(HEADER_BYTES + (random() % (v.byteLength - HEADER_BYTES)), random() & 255);
      });
      try {
        const { indices } = decodeChunk(MeshoptDecoder, header, noisy);
        expect(Math.max(...indices)).toBeLessThan(header.vertexCount);
      } catch (error) {
        expect(error).toBeInstanceOf(ChunkError);
        refused += 1;
      }
    }
    expect(refused).toBeGreaterThan(0);
  });
});

describe("values of a field", () => {
  /** The frame with values behind its payloads. */
  function withValues(steps: readonly number[], low: number, high: number): ArrayBuffer {
    const words = new Uint16Array(2 * steps.length);
    steps.forEach((step, i) => (words[2 * i] = step));
    const coded = MeshoptEncoder.encodeVertexBuffer(new Uint8Array(words.buffer), steps.length, 4);
    const whole = new Uint8Array(frame.byteLength + 8 + coded.byteLength);
    whole.set(frame);
    whole.set(coded, frame.byteLength + 8);
    const view = new DataView(whole.buffer);
    view.setUint8(15, view.getUint8(15) | 2);
    view.setFloat32(frame.byteLength, low, true);
    view.setFloat32(frame.byteLength + 4, high, true);
    return whole.buffer;
  }

  test("are between the ends of their range, or missing; the mesh is as without them", () => {
    const count = mesh.positions.length / 3;
    const steps = Array.from({ length: count }, (_, i) => (i === 3 ? 65535 : (i * 977) % 65535));
    const whole = withValues(steps, -2, 65532);
    const header = readChunkHeader(whole);
    expect(header.valueBytes).toBe(whole.byteLength - frame.byteLength);
    const { values, ...rest } = decodeChunk(MeshoptDecoder, header, whole);
    expect(values).toEqual(Float32Array.from(steps, (step) => (step === 65535 ? NaN : step - 2)));
    expect(rest).toEqual(decodeChunk(MeshoptDecoder, readChunkHeader(frame.buffer), frame.buffer));
  });

  test("that are cut off or out of range are refused", () => {
    const steps = new Array<number>(mesh.positions.length / 3).fill(7);
    const whole = withValues(steps, 0, 1);
    expect(() => readChunkHeader(whole.slice(0, frame.byteLength + 8))).toThrow("and values");
    expect(() => readChunkHeader(tampered((view) => view.setUint8(15, 2)))).toThrow("and values");
    expect(() => readChunkHeader(tampered((view) => view.setUint8(15, 4)))).toThrow("flags 4");
    for (const wrong of [withValues(steps, 1, 0), withValues(steps, NaN, 1), whole.slice(0, -1)]) {
      expect(() => decodeChunk(MeshoptDecoder, readChunkHeader(wrong), wrong)).toThrow(ChunkError);
    }
  });
});
