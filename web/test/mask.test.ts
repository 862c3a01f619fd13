import { describe, expect, test } from "vitest";
import type { IsoReason, Label } from "../src/protocol/generated";
import { firstMask, listHas, maskText, plainValue, readMask, refusedValues, toggled } from "../src/state/mask";

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
    const first = (range: [number, number], reason?: IsoReason, labels?: Label[]) =>
      maskText(firstMask("f", { range, ...(reason && { openingIso: { iso: 0.5, reason, explanation: "" } }), ...(labels && { labels }) }));
    expect(first([0, 40], "labels")).toBe("f==1..40");
    expect(first([0, 1], "labels")).toBe("f==1");
    expect(first([3, 3], "labels")).toBe("f==3");
    expect(first([0, 2035], undefined, [{ value: 1001, name: "bankssts", color: null }])).toBe("f==1..2035");
    expect(first([0, 255], "whole-histogram")).toBe("f>=128");
    expect(first([0, 0.9876543])).toBe("f>=0.494");
    expect(first([-1024, 3071], "bone")).toBe("f>=1020");
  });

  test("of labels are lists from which one is taken or left out", () => {
    const labels = [0, 1, 2, 3, 17, 18];
    expect([1, 17, 4].map((label) => listHas("1..3,17", label))).toEqual([true, true, false]);
    expect(toggled("1..18", 2, labels)).toBe("1,3,17..18");
    expect(toggled("1,3", 2, labels)).toBe("1..3");
    expect(toggled("3", 3, labels)).toBe("");
  });
});
