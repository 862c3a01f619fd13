import { expect, test } from "vitest";
import { linearFromSrgb, lookUp } from "../src/scene/colorTable";

test("colours become linear light, alpha stays", () => {
  const [r, g, b, a] = linearFromSrgb(Uint8Array.of(0, 188, 255, 188));
  expect([r, b]).toEqual([0, 1]);
  // sRGB 188 is half of the light.
  expect(g).toBeCloseTo(0.503, 3);
  expect(a).toBeCloseTo(188 / 255, 6);
});

test("a table through a ramp has the ramp's colours at its own importance", () => {
  const ramp = Uint8Array.of(1, 2, 3, 255, 4, 5, 6, 255, 7, 8, 9, 255);
  const table = Uint8Array.of(90, 91, 92, 255, 90, 91, 92, 0, 90, 91, 92, 130);
  expect([...lookUp(table, ramp)]).toEqual([7, 8, 9, 255, 1, 2, 3, 255, 4, 5, 6, 255]);
});
