import { expect, test } from "vitest";
import { asOperand, faultOf, inserted, isExpression, pointedAt } from "../src/state/expressions";
import { valuesText } from "../src/ui/cards/expressionEditor";
import { VOLUMES } from "./fixture";

test("the server's sentence says what is wrong, and where", () => {
  expect(faultOf('expression: "log(valu)", character 5: no field "valu", expected one of "value"')).toEqual({ at: 4, why: 'no field "valu", expected one of "value"' });
  expect(faultOf("the server's queue is full")).toEqual({ why: "the server's queue is full" });
});

test("a mark stands below the character at fault", () => {
  expect(pointedAt("log(valu)", 4)).toBe("log(valu)\n    ▲");
  expect(pointedAt("a\n+", 3)).toBe("a +\n   ▲");
  expect(pointedAt("é", 99)).toBe("é\n ▲");
});

test("names that are no words stand in quotation marks", () => {
  expect(["rho", "flow x", "2nd", "_a1"].map(asOperand)).toEqual(["rho", '"flow x"', '"2nd"', "_a1"]);
});

test("words are put in at the cursor", () => {
  expect(inserted("2 * ", [4, 4], "rho")).toEqual({ text: "2 * rho", cursor: 7 });
  expect(inserted("a + b", [4, 5], "log()")).toEqual({ text: "a + log()", cursor: 8 });
});

test("what the description does not list is an expression", () => {
  const [volume] = VOLUMES;
  if (volume === undefined) throw new Error("a volume expected");
  const name = volume.fields[0]?.name ?? "";
  expect([name, "none", "gradient-magnitude", "divergence(a,b,c)"].map((known) => isExpression(volume, known))).toEqual([false, false, false, false]);
  expect([`2 * ${name}`, "log(x)", "magnitude(a,b)", "distance(a==3)"].map((text) => isExpression(volume, text))).toEqual([true, true, true, true]);
});

test("what an expression gives is said with its unit", () => {
  expect(valuesText({ range: [0, 2.5], unit: "m/s" })).toBe("Values from 0 to 2.5 m/s");
  expect(valuesText({ range: [-1, 1], unit: null })).toBe("Values from -1 to 1");
  expect(valuesText({ range: [3, 3], unit: null })).toBe("All values are equal, or none is a number");
});
