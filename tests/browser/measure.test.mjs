/** What is measured in the picture: the error of each vertex as colours, distances, angles and values at xs. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
import { before, test } from "node:test";
import { violations } from "./accessibility.mjs";
import { cameraAtRest, difference, frameAfter, MORE, openPage, picture, rested, saveScreenshot, settled, skipTour, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const { MeshoptDecoder } = await import(resolve(import.meta.dirname, "../../web/node_modules/meshoptimizer/meshopt_decoder.mjs"));

/** Along the second axis, the first to the right. */
const CAMERA = "camera=25,-100,22,25,23.5,22";
const CENTER = [25, 23.5, 22];

const at = setUp();

before(() => MeshoptDecoder.ready);

/** The first coordinate of each vertex of a chunk of kind `cut`, in index space. */
function firstCoordinates(chunk) {
  const count = chunk.readUInt32LE(56);
  const vertices = new Uint8Array(12 * count);
  MeshoptDecoder.decodeVertexBuffer(vertices, count, 12, new Uint8Array(chunk.subarray(96, 96 + chunk.readUInt32LE(64))));
  const words = new DataView(vertices.buffer);
  return Array.from({ length: count }, (_, v) => 32 * chunk.readUInt32LE(20) + words.getInt16(12 * v, true) / chunk.readUInt16LE(16));
}

/**
 * A page to whose chunks of kind `error` others are given: near left of the middle, far right of it. `release` lets an annotation through.
 */
async function openTamperedPage() {
  const page = await at.browser.newPage({ viewport: { width: 1100, height: 760 }, colorScheme: "light" });
  page.setDefaultTimeout(TIMEOUT_MS);
  await skipTour(page);
  const xs = new Map();
  const held = [];
  let open = false;
  const line = { release: () => undefined };
  await page.routeWebSocket(/\/api\/v1\/stream$/, (socket) => {
    const pass = (data) => (open || held.push(data) === 0 ? socket.send(data) : undefined);
    line.release = () => {
      open = true;
      for (const data of held.splice(0)) socket.send(data);
    };
    line.hold = () => (open = false);
    const server = socket.connectToServer();
    // Chunks are read here in the coding of every client.
    socket.onMessage((data) => server.send(typeof data === "string" ? data.replace(/"codings":\[[^\]]*\]/, '"codings":[]') : data));
    server.onMessage((data) => {
      if (typeof data === "string") return JSON.parse(data).type === "annotated" ? pass(data) : socket.send(data);
      const region = data.subarray(20, 32).toString("hex");
      if (data[13] === 0) {
        xs.set(region, data.readUInt32LE(56) === 0 ? [] : firstCoordinates(data));
        return socket.send(data);
      }
      const changed = Buffer.from(data);
      xs.get(region).forEach((x, v) => changed.writeFloatLE(x < CENTER[0] ? 0 : 2, 96 + 4 * v));
      return pass(changed);
    });
  });
  await page.goto(`${at.server.url}/#volume=bumpy&color=error&axes=0&scale=0&${CAMERA}`);
  return { page, line };
}

/** The mean colour of what is on a side of the ball, away from its edge. */
function sideColor({ width, height, data }, at) {
  const sum = [0, 0, 0];
  const size = 12;
  for (let y = -size; y < size; y += 1)
    for (let x = -size; x < size; x += 1) {
      const pixel = 4 * (Math.round(height / 2 + y) * width + Math.round(at * width + x));
      for (let c = 0; c < 3; c += 1) sum[c] += data[pixel + c] / (2 * size) ** 2;
    }
  return sum;
}

test("colours of the error are those of each vertex' own distance, and come when it is measured", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, line } = await openTamperedPage();
  await rested(page);
  const waiting = page.locator(".display-legend").getByText("The error is being measured");
  await waiting.waitFor();
  assert.equal(await page.locator(".scene-colors").isVisible(), false);
  const before = sideColor(await picture(page), 0.42);
  assert.ok(before[0] > 120 && Math.abs(before[0] - before[2]) < 70, `ivory: ${before}`);

  line.release();
  await page.locator(".scene-colors").getByText("Off by, in world units").waitFor();
  assert.deepEqual(await page.locator(".scene-colors span").allTextContents(), ["0", "1", "≥ 2"]);
  await waiting.waitFor({ state: "hidden" });
  const now = await picture(page);
  const [near, far] = [sideColor(now, 0.42), sideColor(now, 0.58)];
  // Light yellow, and dark violet.
  assert.ok(near[0] > 120 && near[0] - near[2] > 60, `near: ${near}`);
  assert.ok(far[0] < 90 && far[2] > far[1], `far: ${far}`);
  await saveScreenshot(page, "error-tampered");

  // The former colours are back with the next edit, until it is measured again.
  line.hold();
  const { generation } = await status(page);
  await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
  await waiting.waitFor();
  await page.locator(".scene-colors").waitFor({ state: "hidden" });
  await settled(page, (now, before) => now.generation > before, generation);
  const meanwhile = sideColor(await picture(page), 0.58);
  assert.ok(meanwhile[0] > 120, `ivory again: ${meanwhile}`);
  line.release();
  await page.locator(".scene-colors").waitFor();
  await page.close();
});

test("the error that the server measures is shown with its range, and in images", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&error=0.3vx&${CAMERA}`);
  const { statistics } = await rested(page);
  await page.getByRole("button", { name: "Compare" }).click();
  await page.getByRole("button", { name: "Colour by error" }).click();
  await page.locator(".scene-colors").waitFor();
  const note = await page.getByText(/^Darkest: error/).innerText();
  const [, upper, farthest] = /error ([\d.]+) voxels and more, around 2 % of the vertices; the measured maximum is ([\d.]+) voxels/.exec(note).map(Number);
  // The smallest spacing is 1: world units are voxels.
  assert.equal(await page.locator(".scene-colors span").nth(2).innerText(), `≥ ${upper}`);
  assert.ok(upper > 0.3 * statistics.error.rms && upper <= farthest, note);
  // Of other samples of the surface, so that the farthest is not quite the same.
  assert.ok(farthest > 0.5 * statistics.error.max && farthest < 2 * statistics.error.max, `${note}, measured ${JSON.stringify(statistics.error)}`);
  await saveScreenshot(page, "error");
  // The address follows a little later.
  await page.waitForFunction(() => location.hash.includes("color=error"));
  await page.goto(page.url().replace("/#", "/?embed#"));
  await page.locator(".scene-colors").waitFor();
  assert.deepEqual(await violations(page), [], "embedded");
  assert.deepEqual(faults, []);
  await page.close();
});

test("distances, angles and values are measured, kept, saved and removed", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=0&orthographic=1&error=0.02vx&${CAMERA}`);
  await rested(page);
  await cameraAtRest(page);
  await page.getByRole("button", { name: "Measure" }).click();
  const card = page.getByRole("region", { name: "Measure" });
  const canvas = page.locator(".viewport canvas");
  const box = await canvas.boundingBox();
  const click = (x, y) => page.mouse.click(box.x + x * box.width, box.y + y * box.height);
  await card.getByRole("button", { name: "Distance" }).click();
  await click(0.42, 0.45);
  await card.getByText("Click the other end").waitFor();
  await click(0.42, 0.6);
  const items = card.getByRole("listitem");
  await items.getByText(/^1 · Distance [\d.]+, [\d.]+ voxels$/).waitFor();

  // Keys alone: the picture's centre.
  await card.getByRole("button", { name: "Angle" }).click();
  await click(0.4, 0.4);
  await card.getByText("Click the corner").waitFor();
  await canvas.focus();
  await canvas.press("Enter");
  await card.getByText("Click the end of the other side").waitFor();
  await click(0.4, 0.6);
  await items.getByText(/^2 · Angle [\d.]+°$/).waitFor();
  await card.getByRole("button", { name: "Values" }).click();
  await card.getByRole("button", { name: "Use the centre" }).click();
  await items.getByText(/^3 · depth .*, height [\d.]+$/).waitFor();
  await page.locator(".scene-labels").getByText(/^1 · [\d.]+$/).waitFor();
  await saveScreenshot(page, "measured");
  assert.deepEqual(await violations(page), []);

  const download = page.waitForEvent("download");
  await card.getByRole("button", { name: "Save CSV" }).click();
  const file = await download;
  assert.equal(file.suggestedFilename(), "bumpy-measurements.csv");
  const [head, first, second, third, end] = readFileSync(await file.path(), "utf8").split("\r\n").map((row) => row.split(","));
  assert.deepEqual(head, ["volume", "number", "kind", "amount", "unit", "x1", "y1", "z1", "x2", "y2", "z2", "x3", "y3", "z3", "depth", "height"]);
  assert.deepEqual(end, [""]);
  const points = (row, count) => Array.from({ length: count }, (_, i) => row.slice(5 + 3 * i, 8 + 3 * i).map(Number));
  // On the ball's smooth half, of radius 15.
  for (const point of points(first, 2)) {
    const radius = Math.hypot(...point.map((n, axis) => n - CENTER[axis]));
    assert.ok(Math.abs(radius - 15) < 0.2, `${point} is ${radius} from the centre`);
  }
  const [a, b] = points(first, 2);
  assert.ok(Math.abs(Number(first[3]) - Math.hypot(...a.map((n, axis) => n - b[axis]))) < 1e-3);
  const [c, corner, d] = points(second, 3);
  const side = (end) => end.map((n, axis) => n - corner[axis]);
  const cosine = side(c).reduce((sum, n, axis) => sum + n * side(d)[axis], 0) / Math.hypot(...side(c)) / Math.hypot(...side(d));
  assert.ok(Math.abs(Number(second[3]) - (180 / Math.PI) * Math.acos(cosine)) < 0.01, `${second[3]}° and cosine ${cosine}`);
  // The field `height` is the third coordinate.
  assert.ok(Math.abs(Number(third[15]) - Number(third[7])) < 0.01, third.join());

  // The link brings all of it to another page; undo takes it back.
  await card.getByRole("button", { name: "Remove measurement 2" }).click();
  await page.waitForFunction(() => /measure=d,[^;]*;r,[^;&]*/.test(decodeURIComponent(location.hash)));
  const other = await openPage(at.browser, page.url());
  await rested(other.page);
  await other.page.locator(".scene-labels").getByText(/^1 · [\d.]+$/).waitFor();
  await other.page.close();
  await page.getByRole("button", { name: "Undo" }).click();
  assert.equal(await items.count(), 3);
  await card.getByRole("button", { name: "Remove all" }).click();
  await page.locator(".scene-labels").getByText(/^1 · /).waitFor({ state: "hidden" });
  assert.deepEqual(faults, []);
  await page.close();
});

test("regions of interest are outlined while the card that has them is open", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&iso=0&roi=40,23.5,22,6,0.9&${CAMERA}`);
  await rested(page);
  await cameraAtRest(page);
  const card = page.getByRole("button", { name: "Importance", exact: true }).and(page.locator(".card-head"));
  /** Waits for the frame that follows. */
  const seenAfter = async (act) => {
    const { framesDrawn } = await status(page);
    await act();
    await frameAfter(page, framesDrawn);
    return picture(page);
  };
  const open = await picture(page);
  const folded = await seenAfter(() => card.click());
  const share = difference(open, folded);
  assert.ok(share > 0.0005 && share < 0.02, `${(100 * share).toFixed(3)} % of the pixels have lines`);
  const again = await seenAfter(() => card.click());
  assert.ok(difference(open, again) < 0.0001, "the same lines");
  const pointedAt = await seenAfter(() => page.getByText("Radius 6 at 40, 23.5, 22").hover());
  assert.ok(difference(open, pointedAt) > 0.0005, "brighter lines");
  assert.deepEqual(faults, []);
  await page.close();
});
