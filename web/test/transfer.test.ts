import { describe, expect, test } from "vitest";
import { rampLut, transferLut } from "../src/transfer/lut";
import {
  addPoint,
  formatColor,
  IDENTITY,
  movePoint,
  parseColor,
  recolorPoint,
  removePoint,
  evaluate,
  sorted,
  toWire,
  type Points,
} from "../src/transfer/model";
import { isSameSurface } from "../src/protocol/view";
import { OPENING } from "./fixture";

const point = (x: number, importance: number, color = "#000000") => ({ x, importance, color });

describe("control points", () => {
  test("are sorted, steps keep their order", () => {
    const step = [point(0.5, 1), point(0.2, 0), point(0.5, 0)];
    expect(sorted(step).map((p) => [p.x, p.importance])).toEqual([[0.2, 0], [0.5, 1], [0.5, 0]]);
  });

  test("are linear between and constant beyond, a step takes its right side", () => {
    const points: Points = [point(0.2, 0.1, "#000000"), point(0.4, 0.5, "#64c832"), point(0.4, 0.9), point(0.8, 0.7)];
    const importance = (x: number) => evaluate(points, x).importance;
    expect(importance(0)).toBe(0.1);
    expect(importance(0.3)).toBeCloseTo(0.3, 12);
    expect(importance(0.4)).toBe(0.9);
    expect(importance(0.6)).toBeCloseTo(0.8, 12);
    expect(importance(1)).toBe(0.7);
    expect(evaluate(points, 0.3).color).toEqual({ r: expect.closeTo(50) as number, g: expect.closeTo(100) as number, b: expect.closeTo(25) as number });
  });

  test("are added in order, in the colour at their x", () => {
    const { points, index } = addPoint([point(0, 0, "#000000"), point(1, 1, "#ff8040")], 0.5, 2);
    expect(index).toBe(1);
    expect(points[1]).toEqual({ x: 0.5, importance: 1, color: "#804020" });
  });

  test("are at most 64 and at least 1", () => {
    let points: Points = IDENTITY;
    for (let i = 0; i < 100; i += 1) points = addPoint(points, i / 100, 0.5).points;
    expect(points).toHaveLength(64);
    for (let i = 0; i < 100; i += 1) points = removePoint(points, 0);
    expect(points).toHaveLength(1);
  });

  test("do not pass their neighbours nor leave the unit square", () => {
    const points: Points = [point(0.2, 0), point(0.5, 0.5), point(0.7, 1)];
    expect(movePoint(points, 1, 0.1, -3)[1]).toMatchObject({ x: 0.2, importance: 0 });
    expect(movePoint(points, 1, 0.9, 3)[1]).toMatchObject({ x: 0.7, importance: 1 });
    expect(movePoint(points, 2, 5, 0.4)[2]).toMatchObject({ x: 1, importance: 0.4 });
    expect(movePoint(points, 9, 0, 0)).toBe(points);
  });

  test("recoloured have the same importance", () => {
    const recoloured = recolorPoint(IDENTITY, 1, "#123456");
    expect(recoloured[1]?.color).toBe("#123456");
    const isSame = (points: Points) => isSameSurface({ ...OPENING, transferFunction: { points: IDENTITY } }, { ...OPENING, transferFunction: { points } });
    expect(isSame(recoloured)).toBe(true);
    expect(isSame(movePoint(IDENTITY, 1, 1, 0.9))).toBe(false);
    expect(isSame(addPoint(IDENTITY, 0.5, 0.5).points)).toBe(false);
  });

  test("are sent with five decimals", () => {
    expect(toWire([point(1 / 3, 2 / 3, "#abcdef")])).toEqual({ points: [{ x: 0.33333, importance: 0.66667, color: "#abcdef" }] });
  });

  test("colours are parsed and formatted", () => {
    for (const color of ["#000000", "#0a0b0c", "#ffffff", "#3465a4"]) expect(formatColor(parseColor(color))).toBe(color);
    expect(parseColor("red")).toEqual({ r: 0, g: 0, b: 0 });
  });
});

describe("tables", () => {
  test("hold colour and importance at both ends and the middle", () => {
    const lut = transferLut([point(0, 0.2, "#102030"), point(1, 1, "#f0e0d0")], 257);
    expect([...lut.slice(0, 4)]).toEqual([0x10, 0x20, 0x30, 51]);
    expect([...lut.slice(4 * 128, 4 * 129)]).toEqual([0x80, 0x80, 0x80, 153]);
    expect([...lut.slice(-4)]).toEqual([0xf0, 0xe0, 0xd0, 255]);
  });

  test("of ramps are opaque and contain their stops", () => {
    const lut = rampLut(["#ff0000", "#00ff00", "#0000ff"], 5);
    expect([...lut.slice(8, 12)]).toEqual([0, 255, 0, 255]);
    expect([...lut.slice(16, 20)]).toEqual([0, 0, 255, 255]);
  });
});
