import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { MeshoptDecoder } from "meshoptimizer/decoder";
import { beforeAll, describe, expect, test } from "vitest";
import { decodeChunk, type DecodedChunk } from "../src/decode/decode";
import { ChunkError, HEADER_BYTES, readChunkHeader } from "../src/protocol/chunk";

/** A chunk of the demo in both codings. */
function chunk(coding: "meshopt" | "predictive"): ArrayBuffer {
  const bytes = readFileSync(fileURLToPath(new URL(`../../tests/fixtures/chunks/${coding}.bin`, import.meta.url)));
  return Uint8Array.from(bytes).buffer;
}

const decoded = (frame: ArrayBuffer) => decodeChunk(MeshoptDecoder, readChunkHeader(frame), frame);

/** Triangles of each level, the lowest corner first, as text in order. */
function triangles({ vertices, indices }: DecodedChunk, levels: readonly number[]): readonly string[] {
  const corner = (index: number) => vertices.slice(6 * index, 6 * index + 6).join(",");
  let first = 0;
  return levels.flatMap((count, level) => {
    const of = Array.from({ length: count }, (_, triangle) => {
      const at = first + 3 * triangle;
      const corners = [...indices.slice(at, at + 3)].map(corner);
      const lowest = corners.indexOf([...corners].sort()[0] ?? "");
      return [level, ...corners.slice(lowest), ...corners.slice(0, lowest)].join(" ");
    });
    first += 3 * count;
    return of.sort();
  });
}

beforeAll(() => MeshoptDecoder.ready);

describe("the coding for slow lines", () => {
  test("has the mesh of the other one in fewer bytes", () => {
    const [plain, predictive] = [chunk("meshopt"), chunk("predictive")];
    const header = readChunkHeader(predictive);
    expect(header).toMatchObject({ coding: "predictive", indexBytes: 0 });
    expect(triangles(decoded(predictive), header.levelTriangles)).toEqual(triangles(decoded(plain), readChunkHeader(plain).levelTriangles));
    expect(4 * predictive.byteLength).toBeLessThan(3 * plain.byteLength);
  });

  test("ends where its mesh does", () => {
    const whole = new Uint8Array(chunk("predictive"));
    for (let length = HEADER_BYTES + 1; length < whole.length; length += 3) {
      const shorter = whole.slice(0, length);
      new DataView(shorter.buffer).setUint32(64, length - HEADER_BYTES, true);
      expect(() => decoded(shorter.buffer), `${length} bytes`).toThrow(ChunkError);
    }
  });

  test("never yields indices without a vertex, whatever the bytes", () => {
    const whole = new Uint8Array(chunk("predictive"));
    for (let at = HEADER_BYTES; at < whole.length; at += 1) {
      const damaged = whole.slice();
      damaged[at] = (damaged[at] ?? 0) ^ (1 << (at % 8));
      try {
        const { vertices, indices } = decoded(damaged.buffer);
        expect(Math.max(...indices)).toBeLessThan(vertices.length / 6);
      } catch (error) {
        expect(error).toBeInstanceOf(ChunkError);
      }
    }
  });
});
