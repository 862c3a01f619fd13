/** Acknowledgement (`drawn`) of a first prefix. */

import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { settled, skipTour, TIMEOUT_MS, writeVolume } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(() => {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-"));
  return { path: writeVolume(folder, 128), remove: () => rmSync(folder, { recursive: true }) };
});

/**
 * Opens the page. What the server says of an edit after its first prefix is held back until the page has acknowledged that, however
 * much faster than the picture the server is; `log` has the messages that reached either side, in order.
 */
async function openPageHoldingBack() {
  const page = await at.browser.newPage({ viewport: { width: 1100, height: 760 } });
  page.setDefaultTimeout(TIMEOUT_MS);
  await skipTour(page);
  const log = [];
  await page.routeWebSocket(/\/api\/v1\/stream$/, (socket) => {
    const toServer = socket.connectToServer();
    const acknowledged = new Set();
    let waitsFor;
    const held = [];
    const forward = (data) => {
      if (waitsFor !== undefined) return held.push(data);
      socket.send(data);
      if (typeof data !== "string") return;
      const message = JSON.parse(data);
      log.push(message);
      if (message.type === "committed" && !message.final && !acknowledged.has(message.generation)) waitsFor = message.generation;
    };
    toServer.onMessage(forward);
    socket.onMessage((data) => {
      const message = JSON.parse(data);
      log.push(message);
      toServer.send(data);
      if (message.type === "drawn") acknowledged.add(message.generation);
      // An edit ends the one before it, which is then never drawn.
      if (message.type !== "drawn" && message.type !== "edit") return;
      waitsFor = undefined;
      for (const data of held.splice(0)) forward(data);
    });
  });
  await page.goto(at.server.url);
  return { page, log };
}

test("an edit's first coarse frame is acknowledged once, after its prefix was committed and before the rest of it", { timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, log } = await openPageHoldingBack();
  const { generation: opening } = await settled(page);
  await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
  const { generation } = await settled(page, (now, before) => now.generation > before, opening);
  const types = log.filter((message) => message.generation === generation).map(({ type }) => type);
  assert.equal(types.filter((type) => type === "drawn").length, 1, types.join());
  assert.equal(types.indexOf("drawn"), types.indexOf("committed") + 1, types.join());
  assert.ok(types.indexOf("done") > types.indexOf("drawn"), types.join());
});
