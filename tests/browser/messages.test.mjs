/** What the page shows of messages whose moment the tests choose: progress of an `open`, estimated and measured errors. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { MORE, rested, settled, skipTour, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

/** A page whose messages from the server go through `change`, which returns those to receive instead; and its socket. */
async function openPageThrough(change) {
  const page = await at.browser.newPage({ viewport: { width: 1100, height: 760 } });
  page.setDefaultTimeout(TIMEOUT_MS);
  await skipTour(page);
  const connection = {};
  await page.routeWebSocket(/\/api\/v1\/stream$/, (socket) => {
    connection.send = (message) => socket.send(JSON.stringify(message));
    socket.connectToServer().onMessage((data) => {
      if (typeof data !== "string") return socket.send(data);
      for (const message of change(JSON.parse(data))) connection.send(message);
    });
  });
  await page.goto(at.server.url);
  return { page, connection };
}

test("the page says how far a volume is until it is open", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  let opened;
  const { page, connection } = await openPageThrough((message) => {
    if (message.type === "opening") return [];
    if (message.type !== "opened") return [message];
    opened = message;
    return [{ type: "opening", bytes: 40, totalBytes: 100 }];
  });
  const hint = page.locator(".hint");
  await hint.getByText("40 %").waitFor();
  assert.match(await hint.innerText(), /Opening bumpy/);
  assert.equal(await hint.locator("progress").evaluate((bar) => bar.value), 0.4);
  connection.send({ type: "opening", bytes: 90, totalBytes: 100 });
  await page.locator(".summary").getByText("Opening, 90 %").waitFor();
  connection.send(opened);
  await settled(page);
  await hint.waitFor({ state: "hidden" });
  await page.close();
});

test("an error is shown with its sign while it is an estimate, and not at all where there is none", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  let estimatedError = { rms: 0.0523, worstLeaf: 0.2 };
  const { page, connection } = await openPageThrough((message) => {
    if (message.type === "measured") return [];
    if (message.type !== "done") return [message];
    return [{ ...message, statistics: { ...message.statistics, error: null, estimatedError } }];
  });
  // The surface after which none comes that is better.
  const { generation } = await settled(page, (now) => now.statistics.isTreeCut);
  const error = page.locator(".summary").getByText(/^error/);
  await error.getByText("error ≈ 0.052 voxels (RMS)").waitFor();
  connection.send({ type: "measured", surface: 0, generation, error: { rms: 0.0412, max: 0.31 }, regions: [] });
  await error.getByText("error 0.041 voxels (RMS)").waitFor();

  estimatedError = null;
  await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
  await settled(page, (now, before) => now.generation > before, generation);
  await error.waitFor({ state: "hidden" });
  await page.close();
});

test("guards that gave way are named in words", { timeout: 2 * TIMEOUT_MS }, async () => {
  let gaveWay = ["max-error", "topology"];
  const { page } = await openPageThrough((message) => {
    if (message.type !== "done") return [message];
    return [{ ...message, statistics: { ...message.statistics, gaveWay } }];
  });
  const { generation } = await settled(page);
  const text = page.locator(".limits");
  await text.getByText(/(Error ≈|Max\. error) [\d.]+ voxels.*\. Topology not kept: the budget is too small/).waitFor();

  gaveWay = [];
  await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
  await settled(page, (now, before) => now.generation > before, generation);
  await text.getByText("the budget is too small").waitFor({ state: "hidden" });
  await page.close();
});

test("lengths have the unit that a server names beside the grid, the same everywhere", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  const { page } = await openPageThrough((message) => {
    if (message.type !== "opened") return [message];
    return [{ ...message, volume: { ...message.volume, geometry: { ...message.volume.geometry, unit: "mm" } } }];
  });
  await rested(page);
  await page.locator(".summary").getByText(/^error 0\.\d+ mm \(RMS\)$/).waitFor();
  await page.locator(".scene-scale").getByText(/^\d+ mm at the centre$/).waitFor();
  const rows = page.locator(".card dd");
  await page.getByRole("button", { name: "Data", exact: true }).click();
  await rows.getByText("1 × 1 × 1 mm").waitFor();
  await page.getByRole("button", { name: "Numbers" }).click();
  await page.locator(".enclosed").getByRole("button", { name: "Compute" }).click();
  await rows.getByText(/^[\d,]+ mm²$/).waitFor();
  await page.getByRole("button", { name: "View", exact: true }).click();
  await page.locator(".toggle", { hasText: "Bounding box" }).locator(".toggle-track").click();
  await page.locator(".scene-labels").getByText("x (mm)").waitFor();
  await page.close();
});
