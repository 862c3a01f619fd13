import { describe, expect, test } from "vitest";
import { smoothFeatures } from "../src/decode/smoothing";

/** A square grid of vertices in two triangles a cell, between columns `from` and `to`. */
function grid(from: number, to: number, rows: number, value: (x: number, y: number) => number) {
  const columns = to - from + 1;
  const vertices = new Int16Array(6 * columns * rows);
  const words = new Uint16Array(vertices.buffer);
  const indices: number[] = [];
  const at = (x: number, y: number) => y * columns + x - from;
  for (let y = 0; y < rows; y += 1) {
    for (let x = from; x <= to; x += 1) {
      words.set([value(x, y), 65535 - value(x, y)], 6 * at(x, y) + 4);
      if (x === to || y === rows - 1) continue;
      indices.push(at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y), at(x + 1, y + 1), at(x, y + 1));
    }
  }
  const read = (x: number, y: number) => [words[6 * at(x, y) + 4], words[6 * at(x, y) + 5]];
  return { vertices, indices: Uint16Array.from(indices), read };
}

const checker = (x: number, y: number) => ((x * 7 + y * 13) % 5 < 2 ? 60000 : 1000);

describe("smoothing", () => {
  test("keeps what is equal everywhere, and leaves positions alone", () => {
    const { vertices, indices, read } = grid(0, 8, 9, () => 40000);
    vertices.set([-5, 6, 7, 8], 0);
    smoothFeatures(vertices, indices);
    expect([...vertices.subarray(0, 4)]).toEqual([-5, 6, 7, 8]);
    expect(read(0, 0)).toEqual([40000, 25535]);
    expect(read(4, 4)).toEqual([40000, 25535]);
  });

  test("removes speckle inside and on the boundary", () => {
    const { vertices, indices, read } = grid(0, 20, 21, checker);
    smoothFeatures(vertices, indices);
    const spread = (cells: (number | undefined)[]) => Math.max(...cells.map(Number)) - Math.min(...cells.map(Number));
    const inside = Array.from({ length: 81 }, (_, i) => read(6 + (i % 9), 6 + Math.floor(i / 9))[0]);
    expect(spread(inside)).toBeLessThan(59000 / 10);
    expect(spread(Array.from({ length: 12 }, (_, i) => read(4 + i, 0)[0]))).toBeLessThan(59000 / 2);
  });

  test("is the same on both sides of a border between two regions", () => {
    const left = grid(0, 8, 15, checker);
    const right = grid(8, 19, 15, checker);
    smoothFeatures(left.vertices, left.indices);
    smoothFeatures(right.vertices, right.indices);
    // At both ends three edges meet, of which each region knows two: their neighbours differ a little.
    for (let y = 6; y < 9; y += 1) expect(left.read(8, y)).toEqual(right.read(8, y));
  });

  test("a lone triangle has one value", () => {
    const vertices = new Int16Array(18);
    new Uint16Array(vertices.buffer).set([0, 0], 4);
    new Uint16Array(vertices.buffer).set([30000, 0], 10);
    new Uint16Array(vertices.buffer).set([60000, 0], 16);
    smoothFeatures(vertices, Uint16Array.of(0, 1, 2), 40);
    const words = new Uint16Array(vertices.buffer);
    expect([words[4], words[10], words[16]]).toEqual([30000, 30000, 30000]);
  });
});
