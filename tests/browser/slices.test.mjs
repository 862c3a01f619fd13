/** Slices beside the picture: one crosshair in all of them, window and level, outlines, links, and what is said if the server does not answer. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { PNG } from "pngjs";
import { violations } from "./accessibility.mjs";
import { cameraAtRest, difference, frameAfter, makeVolume, MORE, openPage, picture, rested, saveScreenshot, skipTour, startServer, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

/** Along the second axis: the ball is in the middle of the picture. */
const CAMERA = "camera=25,-100,22,25,23.5,22";
/** Samples of the volume along its axes. */
const DIMS = [50, 47, 44];

const at = setUp();

const panel = (page) => page.getByRole("region", { name: "Slices" }).and(page.locator(".slice-panel"));
const pane = (page, axis) => page.getByRole("img", { name: new RegExp(`^Perpendicular to ${axis} slice`) });

/** Index of the slice across an axis, as its name says. */
async function indexOf(page, axis) {
  const [, index] = /slice, (\d+) of/.exec(await pane(page, axis).getAttribute("aria-label"));
  return Number(index);
}

const crosshair = async (page) => [await indexOf(page, "x"), await indexOf(page, "y"), await indexOf(page, "z")];

/** What stands beside a word below the slices. */
const fact = (page, name) => panel(page).locator(`dt:text-is("${name}") + dd`).innerText();

/** All slices are those that are asked for, and drawn. */
async function drawn(page) {
  await page.waitForFunction(() => document.querySelectorAll(".slice-pane").length === 3 && document.querySelector(".slice-pane.old") === null);
  await page.waitForFunction(() => [...document.querySelectorAll(".slice-picture")].every((canvas) => canvas.width > 1));
  // Another frame, in which canvases are drawn.
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
}

/** Of the samples and outlines, without what lies over them. */
async function pixels(page, axis) {
  const address = await pane(page, axis).evaluate((canvas) => canvas.toDataURL("image/png"));
  return PNG.sync.read(Buffer.from(address.slice(address.indexOf(",") + 1), "base64"));
}

/** How many pixels have about this colour. */
function countOf({ data }, [r, g, b], tolerance = 40) {
  let count = 0;
  for (let i = 0; i < data.length; i += 4) if (Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < tolerance) count += 1;
  return count;
}

async function open(link, options = {}) {
  const opened = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=0&${link}&${CAMERA}`, options);
  await rested(opened.page);
  await cameraAtRest(opened.page);
  return opened;
}

test("a click in a slice or on the surface moves the crosshair in all of them, and a link brings it along", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("axes=0");
  assert.equal(await panel(page).count(), 0, "the picture alone, as before");
  await page.getByRole("button", { name: "Slices beside the picture" }).click();
  await drawn(page);
  assert.deepEqual(await crosshair(page), [25, 23, 22]);
  // 15 − the distance from (25, 23.5, 22).
  assert.equal(await fact(page, "depth"), "14.5");
  assert.equal(await fact(page, "Sample"), "25, 23, 22");

  // The slice across z has x to the right and y upwards; all of it is in sight.
  const box = await pane(page, "z").boundingBox();
  const margin = Math.min(15, box.width / 8, box.height / 8);
  const scale = Math.min((box.width - 2 * margin) / DIMS[0], (box.height - 2 * margin) / DIMS[1]);
  const place = (x, y) => [box.x + box.width / 2 + scale * (x - (DIMS[0] - 1) / 2), box.y + box.height / 2 - scale * (y - (DIMS[1] - 1) / 2)];
  const before = await picture(page);
  const { framesDrawn } = await status(page);
  await page.mouse.click(...place(33, 30));
  await frameAfter(page, framesDrawn);
  await drawn(page);
  assert.deepEqual(await crosshair(page), [33, 30, 22]);
  assert.ok(difference(before, await picture(page)) > 0.0005, "the crosshair in the picture has moved");
  // Above a place its own value is said.
  await page.mouse.move(...place(25, 12));
  await panel(page).getByText("25, 12, 22").waitFor();
  assert.equal(await fact(page, "depth"), "3.5");
  assert.equal(await fact(page, "x, y, z"), "25.0, 12.0, 22.0");
  await page.mouse.move(5, 5);
  await panel(page).getByText("33, 30, 22").waitFor();
  // A drag is one way to get there; its end counts.
  await page.mouse.move(...place(33, 30));
  await page.mouse.down();
  await page.mouse.move(...place(20, 20), { steps: 6 });
  await page.mouse.up();
  await drawn(page);
  assert.deepEqual(await crosshair(page), [20, 20, 22]);

  // The surface, seen along the second axis: its nearest point in the middle is at y = 23.5 − 15.
  const canvas = await page.locator(".viewport canvas").boundingBox();
  await page.mouse.click(canvas.x + canvas.width / 2, canvas.y + canvas.height / 2);
  await page.waitForFunction(() => /y slice, [89] of/.test(document.querySelector('[aria-label^="Perpendicular to y"]').getAttribute("aria-label")));
  await drawn(page);
  const [x, y, z] = await crosshair(page);
  assert.ok(Math.abs(x - 25) <= 1 && Math.abs(y - 8.5) <= 1 && Math.abs(z - 22) <= 1, `at ${x}, ${y}, ${z}`);
  await saveScreenshot(page, "slices");
  assert.deepEqual(await violations(page), []);

  await page.waitForFunction(() => location.hash.includes("crosshair="));
  assert.match(page.url(), /layout=both&crosshair=\d+,\d+,\d+/);
  const other = await openPage(at.browser, page.url());
  await drawn(other.page);
  assert.deepEqual(await crosshair(other.page), [x, y, z]);
  await other.page.close();
  assert.deepEqual(faults, []);
  await page.close();
});

test("wheel and keys go through the slices, the right button changes window and level, a double click resets them", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("layout=both&crosshair=25,23,22&slices=,,5");
  await drawn(page);
  await pane(page, "z").hover();
  await page.mouse.wheel(0, -120);
  await page.waitForFunction(() => document.querySelector('[aria-label^="Perpendicular to z slice, 23 of"]') !== null);
  await page.mouse.wheel(0, 120);
  await page.mouse.wheel(0, 120);
  await page.waitForFunction(() => document.querySelector('[aria-label^="Perpendicular to z slice, 21 of"]') !== null);
  const slice = pane(page, "z");
  await slice.focus();
  await slice.press("PageUp");
  await slice.press("ArrowRight");
  await slice.press("ArrowUp");
  assert.deepEqual(await crosshair(page), [26, 24, 22]);
  await slice.press("Shift+ArrowLeft");
  await slice.press("Shift+PageDown");
  assert.deepEqual(await crosshair(page), [16, 24, 12]);
  await panel(page).getByRole("button", { name: "Next perpendicular to y slice" }).click();
  assert.deepEqual(await crosshair(page), [16, 25, 12]);
  await drawn(page);

  const greys = await pixels(page, "z");
  const box = await slice.boundingBox();
  const [left, top] = [box.x + 0.3 * box.width, box.y + 0.5 * box.height];
  await page.mouse.move(left, top);
  await page.mouse.down({ button: "right" });
  await page.mouse.move(left + 60, top - 40, { steps: 5 });
  await page.mouse.up({ button: "right" });
  await page.waitForFunction(() => location.hash.includes("window="));
  const [low, high] = /window=([-\d.]+),([-\d.]+)/.exec(page.url()).slice(1).map(Number);
  await drawn(page);
  const changed = await pixels(page, "z");
  assert.ok(difference(greys, changed) > 0.3, "other greys");
  assert.deepEqual(await crosshair(page), [16, 25, 12], "and the same place");
  // The drag is one step.
  await page.keyboard.press("Control+z");
  await drawn(page);
  assert.ok(difference(greys, await pixels(page, "z")) < 0.001, "as before");
  await page.keyboard.press("Control+Shift+z");
  await page.mouse.dblclick(left, top);
  await page.waitForFunction(() => !location.hash.includes("window="));
  assert.ok(high > low, `${low} to ${high}`);

  // The slice in the picture is where the crosshair is, and stays there.
  await slice.focus();
  await page.keyboard.press("s");
  await page.waitForFunction(() => document.querySelector(".slice-panel").dataset.layout === "slices");
  assert.equal(await page.locator(".viewport").isVisible(), false);
  await saveScreenshot(page, "slices-alone");
  assert.deepEqual(await violations(page), []);
  const z = await indexOf(page, "z");
  await page.keyboard.press("s");
  await panel(page).waitFor({ state: "detached" });
  await page.waitForFunction((z) => location.hash.includes(`slices=,,${z}`), z);
  assert.equal(await page.evaluate(() => document.activeElement.tagName), "CANVAS", "keys go on in the picture");
  assert.deepEqual(faults, []);
  await page.close();
});

test("each surface that is shown has its outline, in its colour, where its values are", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("layout=slices&crosshair=5,23,22&tint=ff2020&s2.iso=8&s2.tint=20ff20&window=-30,300");
  await drawn(page);
  const [red, green] = [[255, 32, 32], [32, 255, 32]];
  const shown = await pixels(page, "z");
  const [outer, inner] = [countOf(shown, red), countOf(shown, green)];
  // Circles of radius 15 and 7: as long as these, but for bumps.
  assert.ok(outer > 150 && inner > 60, `${outer} and ${inner} pixels`);
  assert.ok(Math.abs(outer / inner - 15 / 7) < 0.5, `${outer} and ${inner} pixels`);
  // Red is where the radius is 15: on the smooth half to within a pixel.
  const { width, height, data } = shown;
  const scale = Math.min((width - 30) / DIMS[0], (height - 30) / DIMS[1]);
  const radii = [];
  for (let y = 0; y < height; y += 1)
    for (let x = 0; x < width / 2 - scale; x += 1) {
      const pixel = 4 * (y * width + x);
      const [u, v] = [(x + 0.5 - width / 2) / scale - 0.5, (height / 2 - y - 0.5) / scale - 0.5];
      if (data[pixel] > 215 && data[pixel + 1] < 70) radii.push(Math.hypot(u, v));
    }
  assert.ok(radii.length > 50 && radii.every((radius) => Math.abs(radius - 15) < 2.5 / scale + 0.05), `radii from ${Math.min(...radii)} to ${Math.max(...radii)}`);

  await page.getByRole("button", { name: "Hide surface 2" }).click();
  await page.waitForFunction(() => [...document.querySelectorAll(".slice-facts dd")].some(({ textContent }) => textContent === "hidden"));
  await drawn(page);
  assert.equal(countOf(await pixels(page, "z"), green), 0);
  // A mask cuts the outline off: the field `height` is the third coordinate.
  await page.goto(page.url().replace(/iso=0/, "iso=0&mask=height%3E%3D22"));
  await page.waitForFunction(() => window.isopeel.status.edit?.mask === "height>=22");
  await drawn(page);
  await page.evaluate(() => new Promise((done) => setTimeout(done, 300)));
  const masked = await pixels(page, "y");
  const rows = [0, 0];
  for (let y = 0; y < masked.height; y += 1) for (let x = 0; x < masked.width; x += 1) if (masked.data[4 * (y * masked.width + x)] > 215 && masked.data[4 * (y * masked.width + x) + 1] < 70) rows[y < masked.height / 2 + 3 ? 0 : 1] += 1;
  assert.ok(rows[0] > 50 && rows[1] === 0, `${rows[0]} pixels above, ${rows[1]} below`);
  // A surface with an opacity of 0 is seen by its outline alone.
  await page.goto(page.url().replace("layout=slices", "layout=both").replace("tint=", "opacity=0&tint=").replace(/(s2\.hidden=1&)?s2\.tint=/, "s2.hidden=1&s2.tint="));
  await page.waitForFunction(() => window.isopeel.status.surfaces[0].style.opacity === 0 && document.querySelector(".slice-panel").dataset.layout === "both");
  await cameraAtRest(page);
  await drawn(page);
  await saveScreenshot(page, "slices-transparent");
  await page.getByText("What is there is hidden or transparent").waitFor();
  assert.ok(countOf(await pixels(page, "z"), red) > 20);
  assert.equal(countOf(await picture(page), red, 120), 0);
  assert.deepEqual(faults, []);
  await page.close();
});

test("a clip plane cuts away the half that is nearer to the camera", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("axes=1");
  for (const card of ["View", "Clip"]) await page.getByRole("button", { name: card, exact: true }).click();
  const plane = page.getByRole("radiogroup", { name: "Plane" });
  for (const [side, normal] of [["−y", "0,-1,0"], ["+y", "0,1,0"]]) {
    await page.getByRole("button", { name: `Look from ${side}` }).click();
    await cameraAtRest(page);
    await plane.getByText("None").click();
    await plane.getByText("⟂ y").click();
    await page.waitForFunction((normal) => location.hash.includes(`plane=${normal},`), normal);
  }
  assert.deepEqual(faults, []);
  await page.close();
});

test("those who follow see the same slices", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const context = await at.browser.newContext();
  const leader = await openPage(context, `${at.server.url}/#volume=bumpy&iso=0&layout=both&crosshair=25,23,22`);
  await rested(leader.page);
  await leader.page.getByRole("button", { name: "Follow me" }).click();
  await leader.page.getByRole("button", { name: "Start", exact: true }).click();
  const started = () => leader.messages.find(({ type }) => type === "group");
  for (const began = Date.now(); started() === undefined; await leader.page.waitForTimeout(50)) assert.ok(Date.now() - began < TIMEOUT_MS, "no group");
  const { group } = started();
  const follower = await openPage(context, `${at.server.url}/#follow=${group}`);
  await drawn(follower.page);
  await pane(leader.page, "z").focus();
  await pane(leader.page, "z").press("PageUp");
  await follower.page.getByRole("img", { name: /^Perpendicular to z slice, 23 of/ }).waitFor();
  assert.deepEqual(await crosshair(follower.page), [25, 23, 23]);
  // A follower cannot move the crosshair or hide the slices.
  await pane(follower.page, "z").focus();
  await pane(follower.page, "z").press("PageUp");
  await pane(follower.page, "z").press("s");
  await pane(follower.page, "z").click({ position: { x: 20, y: 20 } });
  assert.deepEqual(await crosshair(follower.page), [25, 23, 23]);
  assert.equal(await panel(follower.page).getByRole("button", { name: "Next perpendicular to z slice" }).isDisabled(), true);
  assert.equal(await follower.page.getByRole("button", { name: "Slices beside the picture" }).getAttribute("aria-disabled"), "true");
  await leader.page.getByRole("button", { name: "Slices beside the picture" }).click();
  await panel(follower.page).waitFor({ state: "detached" });
  assert.deepEqual([...leader.faults, ...follower.faults], []);
  await context.close();
});

test("a server that refuses is said, the last slices stay as old ones, and nothing is asked at rest", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const page = await at.browser.newPage({ viewport: { width: 390, height: 844 }, colorScheme: "light" });
  page.setDefaultTimeout(TIMEOUT_MS);
  await skipTour(page);
  let asked = 0;
  let isBusy = false;
  await page.route(/\/slices\?/, (route) => {
    asked += 1;
    return isBusy ? route.fulfill({ status: 503, contentType: "application/problem+json", body: JSON.stringify({ detail: "8 slices are being made, which is the maximum" }) }) : route.continue();
  });
  await page.goto(`${at.server.url}/#volume=bumpy&iso=0&layout=both&crosshair=25,23,22&${CAMERA}`);
  await rested(page);
  await drawn(page);
  // A phone: one slice at a time.
  assert.equal(await page.locator(".slice-picture:visible").count(), 1);
  await panel(page).getByRole("button", { name: "Perpendicular to y", exact: true }).click();
  assert.equal(await pane(page, "y").isVisible(), true);
  await saveScreenshot(page, "slices-phone");
  assert.deepEqual(await violations(page), []);
  assert.equal(asked, 3);
  const { framesDrawn } = await status(page);
  await page.waitForTimeout(1500);
  assert.deepEqual([asked, (await status(page)).framesDrawn], [3, framesDrawn]);

  isBusy = true;
  await panel(page).getByRole("button", { name: "Next perpendicular to y slice" }).click();
  await panel(page).getByText("The slices cannot be shown: 8 slices are being made, which is the maximum. What is marked as old is from before").waitFor();
  await panel(page).getByText("old: 23").waitFor();
  assert.equal(asked, 5, "asked twice");
  assert.deepEqual(await violations(page), []);
  isBusy = false;
  await panel(page).getByRole("button", { name: "Try again" }).click();
  await drawn(page);
  assert.equal(await panel(page).getByText("cannot be shown").count(), 0);
  await page.close();
});

test("while there is no connection the panel says so, and the next one brings the slices that are wanted", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const server = await startServer([volume.path]);
  let next;
  try {
    const { page, faults } = await openPage(at.browser, `${server.url}/#volume=bumpy&iso=0&layout=slices&crosshair=25,23,22`);
    await rested(page);
    await drawn(page);
    await server.stop();
    await pane(page, "z").focus();
    await pane(page, "z").press("PageUp");
    await panel(page).getByText("No connection to the server: there are no new slices. What is marked as old is from before").waitFor();
    await panel(page).getByText("old: 22").waitFor();
    // As over the picture.
    await page.locator(".banner").waitFor();
    next = await startServer([volume.path], { port: server.port });
    await drawn(page);
    assert.deepEqual(await crosshair(page), [25, 23, 23]);
    assert.equal(await panel(page).getByText("No connection").count(), 0);
    assert.deepEqual(faults, []);
    await page.close();
  } finally {
    await server.stop();
    await next?.stop();
    volume.remove();
  }
});

test("Control with the wheel and keys zoom a slice, a click there picks the sample that is seen, and a double click shows all of it", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("layout=both");
  await drawn(page);
  const across = pane(page, "z");
  const box = await across.boundingBox();
  const before = await pixels(page, "z");
  const place = [0.35 * box.width, 0.4 * box.height];
  await page.mouse.move(box.x + place[0], box.y + place[1]);
  const sample = async () => (await fact(page, "Sample")).split(", ").map(Number);
  const under = await sample();
  await page.keyboard.down("Control");
  for (let i = 0; i < 4; i += 1) await page.mouse.wheel(0, -100);
  await page.keyboard.up("Control");
  await page.locator(".slice-zoom").getByText(/^× [45]/).waitFor();
  await drawn(page);
  assert.ok(difference(before, await pixels(page, "z")) > 0.05, "it is larger");
  await page.mouse.move(box.x + place[0] + 1, box.y + place[1]);
  // To the next sample at most, at whose border the pointer may be.
  (await sample()).forEach((index, axis) => assert.ok(Math.abs(index - under[axis]) <= 1, "what is under the pointer stays there"));
  await page.mouse.click(box.x + place[0], box.y + place[1]);
  await drawn(page);
  await saveScreenshot(page, "slices-zoomed");
  await across.focus();
  await page.keyboard.press("-");
  await page.keyboard.press("0");
  assert.equal(await page.locator(".slice-zoom").getByText(/^×/).count(), 0);
  await page.keyboard.press("+");
  await page.locator(".slice-zoom").getByText("× 1.3").waitFor();
  await across.dblclick();
  await page.locator(".slice-zoom").getByText(/^×/).waitFor({ state: "detached" });
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("a saved image has the slices beside the picture, or alone where the surface is hidden", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("layout=both");
  await drawn(page);
  const saved = async () => {
    const download = page.waitForEvent("download");
    await page.getByRole("button", { name: "Save PNG" }).click();
    return PNG.sync.read(readFileSync(await (await download).path()));
  };
  await page.getByRole("button", { name: "Export", exact: true }).click();
  const { width, height } = await page.locator(".viewport canvas").first().boundingBox();
  const both = await saved();
  const side = Math.floor((2 * height) / 3);
  assert.deepEqual([both.width, both.height], [2 * width + side, 2 * height]);
  // The outline of the surface is in the column of slices, three times.
  const column = (row) => countOf({ data: cut(both, 2 * width, row * side, side, side) }, [0xff, 0xd3, 0x6b], 60);
  for (const row of [0, 1, 2]) assert.ok(column(row) > 200, `${column(row)} pixels of the outline in slice ${row}`);
  await page.getByRole("switch", { name: "Slices" }).press("Space");
  assert.equal((await saved()).width, 2 * width);
  await page.getByRole("switch", { name: "Slices" }).press("Space");
  await page.locator(".viewport canvas").first().focus();
  await page.keyboard.press("s");
  await drawn(page);
  const alone = await saved();
  assert.equal(alone.width, 3 * alone.height);
  assert.deepEqual(faults, []);
  await page.context().close();
});

/** A part of an image. */
function cut({ data, width }, left, top, w, h) {
  const rows = Array.from({ length: h }, (_, row) => data.subarray(4 * ((top + row) * width + left), 4 * ((top + row) * width + left + w)));
  return Buffer.concat(rows);
}
