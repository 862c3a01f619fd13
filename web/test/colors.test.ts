import { describe, expect, test } from "vitest";
import { COLOR_MAPS, colorAt, colorTable, DISTANCE_COLORS, type ColorMapName } from "../src/colors/maps";
import { SHADINGS } from "../src/scene/look";
import { OWN_COLORS } from "../src/state/surfaceList";
import { LEVEL_COLORS } from "../src/transfer/lut";
import { difference, EYES, seen } from "./vision";

const eyes = Object.keys(EYES) as (keyof typeof EYES)[];
const hex = (rgb: readonly number[]) => `#${rgb.map((c) => Math.round(c).toString(16).padStart(2, "0")).join("")}`;

describe.each(eyes)("levels to eyes of %s", (sight) => {
  test("differ, neighbours clearly", () => {
    LEVEL_COLORS.forEach((color, level) => {
      for (const [other, second] of LEVEL_COLORS.entries()) {
        if (other <= level) continue;
        const apart = difference(color, second, sight);
        expect(apart, `levels ${level} and ${other}`).toBeGreaterThan(other === level + 1 ? 15 : 10);
      }
    });
  });
});

describe.each(eyes)("surfaces to eyes of %s", (sight) => {
  test("differ, and none is ivory", () => {
    const all = [SHADINGS.ivory.color, ...OWN_COLORS];
    all.forEach((color, i) => {
      for (const other of all.slice(i + 1)) expect(difference(color, other, sight), `${color} and ${other}`).toBeGreaterThan(10);
    });
  });
});

describe("colour maps", () => {
  test("have their ends, and interpolate between", () => {
    expect(colorAt(["#000000", "#ff0080"], 0.5)).toEqual([127.5, 0, 64]);
    expect(colorAt(["#000000", "#ff0080"], -3)).toEqual([0, 0, 0]);
    expect(colorAt(["#123456"], 1)).toEqual([0x12, 0x34, 0x56]);
    const table = colorTable(COLOR_MAPS.viridis, 64);
    expect([...table.subarray(0, 4)]).toEqual([0x44, 0x01, 0x54, 255]);
    expect([...table.subarray(252)]).toEqual([0xfd, 0xe7, 0x25, 255]);
  });

  test.each(["batlow", "viridis", "cividis", "magma", "inferno", "plasma", "cubehelix"] as const)("%s grows lighter all the way, to all eyes", (name: ColorMapName) => {
    for (const sight of eyes) {
      const lightness = Array.from({ length: 33 }, (_, i) => seen(hex(colorAt(COLOR_MAPS[name], i / 32)), sight)[0]);
      lightness.slice(1).forEach((l, i) => expect(l, `${sight} at ${i}`).toBeGreaterThan((lightness[i] ?? 1) - 0.003));
      expect((lightness.at(-1) ?? 0) - (lightness[0] ?? 0)).toBeGreaterThan(0.5);
    }
  });

  test.each(["greys", "ylorrd", "ylgnbu"] as const)("%s grows darker all the way, to all eyes", (name: ColorMapName) => {
    for (const sight of eyes) {
      const lightness = Array.from({ length: 33 }, (_, i) => seen(hex(colorAt(COLOR_MAPS[name], i / 32)), sight)[0]);
      lightness.slice(1).forEach((l, i) => expect(l, `${sight} at ${i}`).toBeLessThan((lightness[i] ?? 0) + 0.003));
      expect((lightness[0] ?? 0) - (lightness.at(-1) ?? 0)).toBeGreaterThan(0.5);
    }
  });

  test("that of distances grows darker all the way, to all eyes, in even steps", () => {
    for (const sight of eyes) {
      const colors = Array.from({ length: 17 }, (_, i) => hex(colorAt(DISTANCE_COLORS, i / 16)));
      const lightness = colors.map((color) => seen(color, sight)[0]);
      lightness.slice(1).forEach((l, i) => expect(l, `${sight} at ${i}`).toBeLessThan((lightness[i] ?? 0) + 0.003));
      expect((lightness[0] ?? 0) - (lightness.at(-1) ?? 0)).toBeGreaterThan(0.5);
    }
    const steps = Array.from({ length: 16 }, (_, i) => difference(hex(colorAt(DISTANCE_COLORS, i / 16)), hex(colorAt(DISTANCE_COLORS, (i + 1) / 16)), "normal"));
    expect(Math.max(...steps) / Math.min(...steps)).toBeLessThan(2.5);
  });

  test("vik is lightest in the middle, and its two sides are told apart", () => {
    for (const sight of eyes) {
      const at = (t: number) => hex(colorAt(COLOR_MAPS.vik, t));
      for (const t of [0.05, 0.15, 0.25, 0.35]) {
        expect(seen(at(0.5), sight)[0]).toBeGreaterThan(seen(at(t), sight)[0]);
        expect(difference(at(t), at(1 - t), sight)).toBeGreaterThan(10);
      }
    }
  });
});
