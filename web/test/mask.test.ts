import { describe, expect, test } from "vitest";
import { firstMask, maskText, readMask, refusedValues } from "../src/state/mask";

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
    for (const values of ["1,2", "1..2", "", "x"]) expect(refusedValues("<", values)).toBe(`“${values}” is not one number`);
  });

  test("begin with what a field is likely to be asked for", () => {
    expect(firstMask("labels", { type: "u8", range: [0, 40] })).toEqual({ field: "labels", comparison: "==", values: "1" });
    expect(firstMask("empty", { type: "u8", range: [0, 0] }).values).toBe("0");
    expect(firstMask("p", { type: "f32", range: [0, 0.9876543] })).toEqual({ field: "p", comparison: ">=", values: "0.494" });
    expect(firstMask("ct", { type: "i16", range: [-1024, 3071] })).toEqual({ field: "ct", comparison: ">=", values: "1020" });
  });
});
