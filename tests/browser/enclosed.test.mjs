/** Area and enclosed volume of what is shown: of a ball, whose numbers are known, and of the demo. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { MORE, openPage, rested, saveScreenshot, settled, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(undefined, { demo: true });

/** Opens the card, asks, and returns the rows by their names. */
async function summedUp(page) {
  const card = page.locator(".enclosed");
  await card.getByRole("button", { name: "Compute" }).click();
  // A better surface that comes meanwhile is summed up again.
  await rested(page);
  await card.locator(".note").filter({ hasNotText: "Computing" }).waitFor();
  await card.getByText("Area").and(page.locator("dt")).waitFor();
  const [names, values] = await Promise.all([card.locator("dt").allInnerTexts(), card.locator("dd").allInnerTexts()]);
  return { rows: Object.fromEntries(names.map((name, i) => [name, values[i]])), note: await card.locator(".note").innerText() };
}

const number = (text) => Number(/^[\d.,]+/.exec(text)[0].replaceAll(",", ""));

test("area and volume of a ball, which end with the next edit", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=5&error=0.05vx`);
  await rested(page);
  await page.getByRole("button", { name: "Numbers" }).click();
  const { rows, note } = await summedUp(page);
  assert.match(rows["Enclosed volume"], / world units³$/);
  // The field falls by 1 a cell outwards but for the bumps: at 5 a ball of radius 10, whose bumps, up and down by 1.4, add a third of a cell to it at most.
  const [volume, area] = [number(rows["Enclosed volume"]), number(rows.Area)];
  assert.ok(Math.abs(volume / ((4 / 3) * Math.PI * 10 ** 3) - 1) < 0.06, rows["Enclosed volume"]);
  assert.ok(area > 0.99 * 4 * Math.PI * 10 ** 2 && area < 1.2 * 4 * Math.PI * 10 ** 2, rows.Area);
  assert.match(note, /^Of the mesh on screen, with what is clipped or peeled away; error 0\.\d+ voxels \(RMS\)\.$/);

  // Where the ball leaves the volume it is open.
  const field = page.getByRole("textbox", { name: "Isovalue" });
  await field.fill("-9");
  await field.press("Enter");
  await page.locator(".enclosed").getByRole("button", { name: "Compute" }).waitFor();
  await settled(page, (now) => now.edit.iso === -9);
  const open = await summedUp(page);
  assert.equal(open.rows["Enclosed volume"], "none, it is open");
  assert.match(open.note, /^The surface ends at [\d,]+ edges: /);
  assert.ok(number(open.rows.Area) > 2 * area);
  assert.deepEqual(faults, []);
  await page.close();
});

test("area and volume of the demo", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=mni152`, { viewport: { width: 1400, height: 900 } });
  await rested(page);
  await page.getByRole("button", { name: "Numbers" }).click();
  const { rows, note } = await summedUp(page);
  // A brain: 1 to 2 litres, in cubic millimetres.
  const volume = number(rows["Enclosed volume"]);
  assert.ok(volume > 1e6 && volume < 2.5e6, JSON.stringify(rows));
  assert.match(note, /^Of the mesh/);
  await page.locator(".enclosed").scrollIntoViewIfNeeded();
  await saveScreenshot(page, "enclosed");
  assert.deepEqual(await violations(page, ".enclosed"), []);
  assert.deepEqual(faults, []);
  await page.close();
});
