import { describe, expect, test } from "vitest";
import { readTyped, unitsOf } from "../src/state/typedNumber";
import { formatBytes, formatCount, formatLength, formatShare, formatValue } from "../src/ui/format";

const WHOLE = { isWhole: true, min: 1, hundredPercent: 662_406, units: { triangles: 1 } };

describe("typed numbers", () => {
  test("unfinished text is none", () => {
    for (const text of ["", "-", "+", "1e", "1e-", ".", ",", "1.2.3", "0x10", "12 cm", "Infinity", "NaN", "1,2,3", "1,02,345", "1 02", "5 %", "1e5k2", "1.000,000.0", "- 1 2"]) {
      expect(readTyped(text), text).toBeUndefined();
    }
  });

  test("plain ones have a decimal point or comma", () => {
    const read = [" 517 ", "-2e3", "1,5", ".5", "−3", "1.", "1,", "1.024", "0,024", "1234,567", "12,34", "≈ 0.11", "+7"].map((text) => readTyped(text));
    expect(read).toEqual([517, -2000, 1.5, 0.5, -3, 1, 1, 1.024, 0.024, 1234.567, 12.34, 0.11, 7]);
  });

  test("groups of three are recognised by comma, point, space and apostrophe", () => {
    for (const text of ["1,234,567", "1 234 567", "1\u202f234\u00a0567", "1'234’567", "1.234.567", "1_234_567"]) expect(readTyped(text), text).toBe(1_234_567);
    expect(["5 000", "163'108", "1,024.5", "1.024,5", "-1 000,25"].map((text) => readTyped(text))).toEqual([5000, 163_108, 1024.5, 1024.5, -1000.25]);
  });

  test("one comma before three digits may be either, unless the field decides", () => {
    expect(readTyped("1,024")).toEqual([1024, 1.024]);
    expect(readTyped("-1,024")).toEqual([-1024, -1.024]);
    expect(readTyped("163,108", WHOLE)).toBe(163_108);
    expect(readTyped("163.108", WHOLE)).toBe(163_108);
    expect(readTyped("1,024", { min: 0, max: 100 })).toBe(1.024);
    expect(readTyped("1,024", { min: 10 })).toBe(1024);
  });

  test("percent, thousands and units multiply", () => {
    expect(["20%", "20 %", "20k", "1.5 M", "1,5M", "87,501 triangles"].map((text) => readTyped(text, WHOLE))).toEqual([132_481.2, 132_481.2, 20_000, 1_500_000, 1_500_000, 87_501]);
    expect(readTyped("0.5 mm", { units: unitsOf("mm", 2) })).toBe(1);
    expect(readTyped("300 K", { units: unitsOf("K") })).toBe(300);
    expect([unitsOf(undefined), unitsOf(null), unitsOf("")]).toEqual([{}, {}, {}]);
  });

  test("every number that the page writes is read back", () => {
    const units = { voxels: 1, voxel: 1 };
    for (const n of [1, 999, 1000, 163_108, 1_234_567]) expect(readTyped(formatCount(n), WHOLE), formatCount(n)).toBe(n);
    for (const n of [0.3, 1234.5, -33.017, 3.0143e-10, -2.5e11, 1e12]) expect(readTyped(formatValue(n)), formatValue(n)).toBe(n);
    for (const n of [0.11, 1, 15.6]) expect(readTyped(`≈ ${formatLength(n, { spacing: 1, unit: undefined })}`, { units }), String(n)).toBeCloseTo(n, 0);
    expect(readTyped(formatShare(0.19), { hundredPercent: 1 })).toBe(0.19);
    expect(readTyped(formatBytes(252_000), { units: { kB: 1000 } })).toBe(252_000);
  });
});
