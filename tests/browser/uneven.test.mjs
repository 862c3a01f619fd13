/** A rectilinear grid whose levels grow by a third: what is on screen is where the samples are in the world. */

import assert from "node:assert/strict";
import { resolve } from "node:path";
import { test } from "node:test";
import { MORE, openPage, rested, saveScreenshot, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const FILE = resolve(import.meta.dirname, "../fixtures/volumes/uneven.vtr");
const at = setUp(() => ({ path: FILE, remove: () => undefined }));

/** Half the height of the grid, and the half axes of the body inside it, but for a slant. */
const MIDDLE = (0.5 * 0.0125 * (1.34 ** 16 - 1)) / 0.34;
const VOLUME = ((4 / 3) * Math.PI * 0.8 * MIDDLE) / Math.sqrt(1 / (1.2 * 1.1) ** 2 - 0.05 ** 2);

test("surfaces, slices and volumes are those of the world", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=uneven&iso=1&error=0&share=1&slices=7,,3`, { colorScheme: "light" });
  const shown = await rested(page);
  assert.ok(shown.triangles > 500, `${shown.triangles} triangles`);
  assert.equal(shown.edit.feature, "gradient-magnitude", "its derivatives are known there");
  await page.getByRole("button", { name: "Numbers" }).click();
  const card = page.locator(".enclosed");
  await card.getByRole("button", { name: "Compute" }).click();
  await card.getByText("Area").and(page.locator("dt")).waitFor();
  const text = await card.locator("dd").nth(1).innerText();
  const found = Number(/^[\d.,]+/.exec(text)[0].replaceAll(",", ""));
  assert.ok(Math.abs(found / VOLUME - 1) < 0.05, `${text}, expected about ${VOLUME}`);
  await saveScreenshot(page, "uneven");
  assert.deepEqual(faults, []);
});
