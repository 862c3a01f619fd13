/** Pieces of the surface are hidden or kept alone by a click: what is seen, what a link keeps, and what the mesh that is saved has. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { cameraAtRest, makeBalls, MORE, openPage, picture, rested, saveScreenshot, settled, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

/** Along the second axis, the first to the right: a ball left, one right, and a small one between and above them. */
const CAMERA = "orthographic=1&axes=0&scale=0&camera=30,-120,22,30,20,22";

const at = setUp(makeBalls);

/** The balls that are in the picture, from left to right: how large each is, and its middle. */
function seen({ width, height, data }) {
  // The background is what is at the corner.
  const isSurface = (x, y) => [0, 1, 2].some((c) => Math.abs(data[4 * (y * width + x) + c] - data[c]) > 40);
  const columns = Array.from({ length: width }, (_, x) => Array.from({ length: height }, (_, y) => y).filter((y) => isSurface(x, y)));
  const balls = [];
  columns.forEach((ys, x) => {
    if (ys.length === 0) return;
    if (columns[x - 1]?.length > 0) balls.at(-1).push([x, ys]);
    else balls.push([[x, ys]]);
  });
  return balls
    .filter((slices) => slices.length > 20)
    .map((slices) => {
      const [[left], [right]] = [slices[0], slices.at(-1)];
      const middle = slices[Math.floor(slices.length / 2)][1];
      return { size: slices.length > 100 ? "large" : "small", x: (left + right) / 2, y: (middle[0] + middle.at(-1)) / 2 };
    });
}

const sizes = (image) => seen(image).map(({ size }) => size);

async function openBalls(hash = "") {
  const opened = await openPage(at.browser, `${at.server.url}/#volume=balls&iso=0&error=0.05vx&${CAMERA}${hash}`, { colorScheme: "light", viewport: { width: 1400, height: 900 } });
  await rested(opened.page);
  await cameraAtRest(opened.page);
  return opened;
}

test("a click hides a part or keeps it alone, links and meshes follow, and all of it is undone", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openBalls();
  const card = page.getByRole("region", { name: "Surface", exact: true });
  const canvas = page.locator(".viewport canvas");
  const items = card.getByRole("list", { name: "Chosen parts" }).getByRole("listitem");
  /** After an edit: so many of three balls are removed, and these are seen from left to right. */
  const shows = async (removed, expected) => {
    await settled(page, (now, removed) => (now.statistics.removedParts ?? 0) === removed && now.statistics.isTreeCut && now.statistics.triangles === now.triangles, removed);
    await cameraAtRest(page);
    assert.deepEqual(sizes(await picture(page)), expected);
  };
  const clickOn = async (place) => {
    const [box, shot] = [await canvas.boundingBox(), await picture(page)];
    const { x, y } = seen(shot).at(place);
    await page.mouse.click(box.x + (x * box.width) / shot.width, box.y + (y * box.height) / shot.height);
  };
  const all = (await settled(page)).statistics.triangles;
  await shows(0, ["large", "small", "large"]);

  await card.getByRole("button", { name: "Parts of the surface" }).click();
  await card.getByRole("button", { name: "Hide part" }).click();
  await clickOn(0);
  await items.getByText(/^Hidden at [\d.]+, [\d.]+, [\d.]+$/).waitFor();
  await shows(1, ["small", "large"]);
  await card.getByText("1 part hidden").waitFor();
  assert.deepEqual(await violations(page), []);
  await saveScreenshot(page, "part-hidden");
  await page.waitForFunction(() => /parts=hide:/.test(decodeURIComponent(location.hash)));

  const other = await openPage(at.browser, page.url(), { colorScheme: "light", viewport: { width: 1400, height: 900 } });
  const again = await rested(other.page);
  assert.equal(again.statistics.removedParts, 1);
  assert.equal(again.triangles, (await settled(page)).triangles);
  await cameraAtRest(other.page);
  assert.deepEqual(sizes(await picture(other.page)), ["small", "large"]);
  await other.page.close();

  await page.getByRole("button", { name: "Share and export" }).click();
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("menuitem", { name: /STL/ }).click()]);
  const stl = readFileSync(await download.path());
  const corners = Array.from({ length: stl.readUInt32LE(80) * 3 }, (_, i) => stl.readFloatLE(84 + 50 * Math.floor(i / 3) + 12 + 12 * (i % 3)));
  // The left ball ends at 26.
  assert.ok(corners.length > 0 && corners.every((x) => x > 26.5), "the file has something of the hidden ball");

  await card.getByRole("button", { name: "Keep part" }).click();
  await clickOn(-1);
  await shows(2, ["large"]);
  await card.getByText("1 part kept, all others hidden").waitFor();

  // The two large ones are alike: only their numbers tell them apart.
  await card.getByRole("button", { name: "Keep another" }).click();
  await shows(0, ["large", "small", "large"]);
  await clickOn(0);
  await shows(1, ["large", "large"]);
  await card.getByText("2 parts kept, all others hidden").waitFor();
  await card.getByRole("button", { name: "Hide part" }).click();
  await clickOn(0);
  await shows(2, ["large"]);
  const shot = await picture(page);
  assert.ok(seen(shot)[0].x > shot.width / 2, "the one on the right is left");
  await clickOn(0);
  await page.getByText(/^This is the only part that is shown/).waitFor();
  await page.getByRole("button", { name: "Undo" }).click();
  await shows(1, ["large", "large"]);
  await page.getByRole("button", { name: "Undo" }).click();
  await shows(2, ["large"]);
  await card.getByRole("button", { name: "Keep another" }).click();
  await shows(0, ["large", "small", "large"]);
  await card.getByRole("button", { name: "Keep another" }).click();
  await shows(2, ["large"]);
  await page.getByRole("button", { name: "Undo" }).click();
  await shows(1, ["small", "large"]);
  await page.getByRole("button", { name: "Undo" }).click();
  await shows(0, ["large", "small", "large"]);
  assert.equal((await settled(page)).statistics.triangles, all);
  await page.getByRole("button", { name: "Redo" }).click();
  await shows(1, ["small", "large"]);

  await items.getByRole("button", { name: "Show part 1" }).click();
  await shows(0, ["large", "small", "large"]);
  assert.deepEqual(faults, []);
  await page.close();
});

test("the tool is used at the centre by a key and a button", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openBalls("&camera=44,-120,20,44,20,20");
  const card = page.getByRole("region", { name: "Surface", exact: true });
  await card.getByRole("button", { name: "Parts of the surface" }).click();
  await card.getByRole("button", { name: "Keep part" }).click();
  await card.getByRole("button", { name: "Use the centre" }).click();
  await settled(page, (now) => now.statistics.removedParts === 2);
  await card.getByRole("button", { name: "Show all" }).click();
  await settled(page, (now) => now.statistics.removedParts === null);
  await card.getByRole("button", { name: "Hide part" }).click();
  await page.locator(".viewport canvas").focus();
  await page.keyboard.press("Enter");
  await settled(page, (now) => now.statistics.removedParts === 1);
  assert.deepEqual(faults, []);
  await page.close();
});
