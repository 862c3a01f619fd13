/** A mask restricts a surface to where another field has certain values: what is seen, what a link keeps, what is refused. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeVolume, MORE, openPage, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(makeVolume);

test("a surface is shown only where another field has the values of its mask", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=0&error=0`, { colorScheme: "light" });
  const whole = await rested(page);
  const card = page.getByRole("region", { name: "Surface", exact: true });
  await card.getByRole("button", { name: "Mask of the surface" }).click();
  await card.getByRole("combobox", { name: "Restrict to" }).selectOption("height");
  await page.waitForFunction(() => window.isopeel.status.edit.mask !== null);
  const half = await rested(page);
  assert.ok(half.triangles > 0 && half.triangles < 0.8 * whole.triangles, `${half.triangles} of ${whole.triangles} triangles`);
  await saveScreenshot(page, "mask");
  const values = card.getByRole("textbox", { name: "Values of the mask" });
  await values.fill("1,2,3");
  await values.press("Enter");
  await page.getByText("“1,2,3” is not one number").waitFor();
  assert.equal(await values.inputValue(), "1,2,3", "what is refused stays to be mended");
  assert.equal((await status(page)).edit.mask, half.edit.mask, "and is not taken");
  await values.press("Escape");
  assert.equal(await values.inputValue(), half.edit.mask.split(">=")[1]);
  await page.waitForFunction(() => decodeURIComponent(location.hash).includes("mask=height>="));
  const again = await openPage(at.browser, page.url());
  assert.equal((await rested(again.page)).triangles, half.triangles, "the link brings the mask");
  await again.page.close();
  await page.getByRole("button", { name: "Undo" }).click();
  await settled(page, () => window.isopeel.status.edit.mask === null);
  assert.equal((await rested(page)).triangles, whole.triangles);
  assert.deepEqual([...faults, ...again.faults], []);
});
