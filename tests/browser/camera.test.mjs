/** Surfaces follow the camera: what it sees from near is finer. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { cameraAtRest, MORE, openPage, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(() => ({ paths: [], remove: () => undefined }), { demo: true });

const LINK = "#v=1&volume=mni152&triangles=20000&wire=1";

const cameras = (messages) => messages.filter(({ type, camera }) => type === "camera" && camera !== undefined);

/** Zooms in at the middle of the picture. */
async function zoomIn(page, times) {
  const box = await page.locator(".viewport canvas").boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  for (let i = 0; i < times; i += 1) await page.mouse.wheel(0, -240);
  await cameraAtRest(page);
}

test("the surface gets finer where the camera looks, without an edit", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults, messages } = await openPage(at.browser, `${at.server.url}/${LINK}`);
  const before = await settled(page, ({ statistics }) => statistics?.pixels);
  await saveScreenshot(page, "camera_far");
  assert.ok(before.triangles <= 20_000, `${before.triangles} triangles`);
  const [first] = cameras(messages);
  assert.deepEqual(first.camera.viewport.map(Math.round), first.camera.viewport);
  const edits = messages.filter(({ type }) => type === "edit").length;
  await zoomIn(page, 6);
  const near = await settled(page, (now, generation) => now.generation > generation && now.statistics.pixels, before.generation);
  await saveScreenshot(page, "camera_near");
  assert.notDeepEqual(near.statistics.pixels, before.statistics.pixels);
  assert.ok(near.triangles <= 20_000, `${near.triangles} triangles`);
  // A pixel is smaller there, and the error in pixels has not grown as much.
  const distance = ({ camera }) => Math.hypot(...camera.position.map((p, axis) => p - camera.target[axis]));
  const grown = near.statistics.pixels.within / before.statistics.pixels.within;
  assert.ok(grown < 0.8 * (distance(before) / distance(near)), `error in pixels times ${grown}, zoomed by ${distance(before) / distance(near)}`);
  assert.deepEqual(near.edit, before.edit);
  assert.equal(messages.filter(({ type }) => type === "edit").length, edits);
  assert.equal(await page.getByRole("button", { name: "Undo" }).getAttribute("aria-disabled"), "true");
  assert.match(await page.locator(".limits .steady").innerText(), /^Error up to about .* px at this view: /);
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("the camera is not sent while nothing follows it, and sent again when something does", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults, messages } = await openPage(at.browser, `${at.server.url}/${LINK}&detail=uniform`);
  const before = await settled(page, ({ statistics }) => statistics?.isTreeCut);
  await zoomIn(page, 4);
  const near = await settled(page);
  assert.deepEqual(cameras(messages), []);
  assert.equal(near.generation, before.generation);
  assert.equal(near.statistics.pixels, null);
  await page.getByRole("switch", { name: "Finer where you look" }).press("Space");
  const finer = await settled(page, ({ edit, statistics }) => edit.detail === "view" && statistics.pixels);
  assert.equal(cameras(messages).length, 1);
  assert.ok(finer.triangles <= 20_000, `${finer.triangles} triangles`);
  await page.waitForFunction(() => !window.location.hash.includes("detail="));
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("the surface of an image is made for the image", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults, messages } = await openPage(at.browser, `${at.server.url}/${LINK}`);
  await rested(page);
  const own = cameras(messages).at(-1).camera;
  await page.getByRole("button", { name: "Export", exact: true }).click();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save PNG" }).click()]);
  assert.equal(await download.failure(), null);
  await settled(page);
  const [ofImage, again] = cameras(messages).slice(-2).map(({ camera }) => camera);
  assert.deepEqual(again, own);
  assert.deepEqual(ofImage.viewport, own.viewport.map((pixels) => 2 * pixels));
  const done = messages.findLastIndex(({ camera }) => camera === ofImage);
  assert.ok(messages.slice(done).some(({ type }) => type === "done"));
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("a command and the status name what is seen", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  const { page } = await openPage(at.browser, `${at.server.url}/${LINK}`, { permissions: ["clipboard-read", "clipboard-write"] });
  await rested(page);
  await page.getByRole("button", { name: "Export", exact: true }).click();
  await page.getByRole("button", { name: "Command", exact: true }).click();
  const text = await page.evaluate(() => navigator.clipboard.readText());
  const { camera } = await status(page);
  const [numbers] = /--camera (\S+)/.exec(text).slice(1);
  numbers.split(",").slice(0, 3).forEach((n, axis) => assert.ok(Math.abs(Number(n) - camera.position[axis]) < 1e-3));
  assert.match(text, /--viewport \d+x\d+ --fov [\d.]+ /);
  await page.context().close();
});
