import { describe, expect, test } from "vitest";
import { firstMask, maskText, plainValue, readMask, refusedValues } from "../src/state/mask";

describe("masks", () => {
  test("are read as they are written, by their first comparison", () => {
    for (const text of ["labels==1,4..7", "labels!=3", "p (bone)>=0.5", "p<=-1", "p>1", "p<1e-3"]) {
      const mask = readMask(text);
      expect(mask === undefined ? "" : maskText(mask)).toBe(text);
    }
    expect(readMask(" grey matter >= 0.5 ")).toEqual({ field: "grey matter", comparison: ">=", values: "0.5" });
    expect(readMask("labels")).toBeUndefined();
  });

  test("take lists of numbers and ranges behind is and is not, one number behind others", () => {
    for (const values of ["1", " 1, 4 .. 7", "-1.5..2e3,.5"]) expect(refusedValues("==", values)).toBeUndefined();
    expect(refusedValues(">=", "0.5")).toBeUndefined();
    expect(refusedValues("!=", "1,,2")).toMatch(/^“” is neither a number/);
    expect(refusedValues("==", "bone")).toMatch(/^“bone” is neither a number nor a range/);
    expect(refusedValues("==", "1, 7..4")).toBe("“7..4” begins above its end");
    expect(refusedValues("==", Array(65).fill("1").join(","))).toMatch(/^65 values, 64/);
    expect(["0,5", "1,024"].map((values) => refusedValues("<", values))).toEqual([undefined, "“1,024” can be read in two ways: write it without a comma"]);
    expect([" 0,5 ", "2e3", "5 000", "x "].map(plainValue)).toEqual(["0.5", "2000", "5000", "x"]);
    for (const values of ["1,2,3", "1..2", "", "x"]) expect(refusedValues("<", values)).toBe(`“${values}” is not one number`);
  });

  test("begin with what a field is likely to be asked for", () => {
    const few = { counts: [9, 0, 4, 1] };
    const many = { counts: Array(256).fill(1) };
    const first = (type: string, range: [number, number], histogram: { counts: number[] }) => maskText(firstMask("f", { type, range, histogram }));
    expect(first("u8", [0, 40], few)).toBe("f==1");
    expect(first("u8", [0, 0], few)).toBe("f==0");
    expect(first("u8", [0, 255], many)).toBe("f>=128");
    expect(first("f32", [0, 0.9876543], few)).toBe("f>=0.494");
    expect(first("i16", [-1024, 3071], many)).toBe("f>=1020");
  });
});
