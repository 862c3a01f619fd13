/** What stays as it is: texts in small windows, the camera while the surface changes, the console while something is typed. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { cameraAtRest, MORE, openPage, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

test("the status of a phone on its side has one line, and a field's name the space that there is", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, at.server.url, { viewport: { width: 844, height: 390 } });
  await rested(page);
  const sentence = page.locator(".sentence");
  const { height } = await sentence.boundingBox();
  const line = await sentence.evaluate((element) => parseFloat(getComputedStyle(element).lineHeight));
  assert.ok(height < 1.5 * line, `${height} pixels, of lines of ${line}`);
  await saveScreenshot(page, "phone-on-its-side");
  await page.setViewportSize({ width: 1280, height: 800 });
  const select = await page.getByRole("combobox", { name: "Field", exact: true }).boundingBox();
  const card = await page.getByRole("region", { name: "Surface", exact: true }).boundingBox();
  assert.ok(select.width > 0.55 * card.width, `${select.width} of ${card.width} pixels`);
  assert.deepEqual(faults, []);
  await page.close();
});

test("what is typed into an expression and not right, and a server without uploads, are no errors on the console", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, at.server.url);
  const failed = [];
  page.on("response", (response) => response.status() >= 400 && failed.push(`${response.status()} ${response.url()}`));
  await rested(page);
  await page.getByRole("button", { name: "Compute a field…" }).click();
  await page.getByRole("textbox", { name: "Expression of the field" }).fill("log(depth");
  await page.locator(".fault-text").waitFor();
  await page.getByRole("button", { name: "Your volumes: upload files" }).click();
  await page.getByText("Uploads are disabled on this server (--uploads DIR)").waitFor();
  assert.deepEqual([failed, faults], [[], []]);
  await page.close();
});

test("another isovalue does not move the camera, and a surface can be made invisible", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  // At the edge of the surface, whose neighbours are smaller and larger.
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=-4&camera=25,-60,40,25,8,36`);
  await rested(page);
  await page.locator(".viewport canvas").first().press("ArrowLeft");
  await cameraAtRest(page);
  const { camera } = await status(page);
  const field = page.getByRole("textbox", { name: "Isovalue", exact: true });
  for (const iso of [12, 3, -15]) {
    await field.fill(String(iso));
    await field.press("Enter");
    await settled(page, ({ edit, statistics }, iso) => edit.iso === iso && statistics?.triangles > 0, iso);
    await rested(page);
    await cameraAtRest(page);
    const now = (await status(page)).camera;
    for (const name of ["position", "target"]) now[name].forEach((value, axis) => assert.ok(Math.abs(value - camera[name][axis]) < 1e-3, `${name} at ${iso}: ${now[name]}, was ${camera[name]}`));
  }
  await page.getByRole("button", { name: "Opacity and colour" }).click();
  const opacity = page.getByRole("textbox", { name: "Opacity of the surface, percent" });
  await opacity.fill("0");
  await opacity.press("Enter");
  await page.waitForFunction(() => window.isopeel.status.surfaces[0].style.opacity === 0);
  assert.deepEqual(faults, []);
  await page.close();
});

test("a turn is painted as finely as this machine can, and the picture at rest in full", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&error=0&opacity=0.5`, { viewport: { width: 1400, height: 900 }, deviceScaleFactor: 2 });
  await rested(page);
  const canvas = page.locator(".viewport canvas").first();
  const { x, y, width, height } = await canvas.boundingBox();
  const before = (await status(page)).framesDrawn;
  await page.mouse.move(x + width / 2, y + height / 2);
  await page.mouse.down();
  for (let i = 0; i < 60; i += 1) await page.mouse.move(x + width / 2 + 150 * Math.sin(i / 5), y + height / 2);
  await page.mouse.up();
  await cameraAtRest(page);
  assert.ok((await status(page)).framesDrawn > before + 2, "it has turned");
  assert.deepEqual(await canvas.evaluate((of) => [of.width, of.height]), [2 * width, 2 * height].map(Math.floor), "at rest each pixel of the screen has one");
  assert.deepEqual(faults, []);
  await page.close();
});
