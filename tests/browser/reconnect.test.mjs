/** A server that stops and starts again: surface, camera and the user's values are kept. */

import assert from "node:assert/strict";
import { connect, createServer } from "node:net";
import { test } from "node:test";
import { cameraAtRest, decideBy, difference, makeVolume, openPage, rested, saveScreenshot, settled, startBrowser, startServer, status, stillPicture, TIMEOUT_MS } from "./harness.mjs";

test("reconnects after the server restarts", { timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  let server = await startServer([volume.path]);
  const browser = await startBrowser();
  try {
    const { page, faults } = await openPage(browser, server.url);
    await settled(page);
    await decideBy(page, "β (paper)");
    const field = page.getByRole("textbox", { name: "β" });
    await field.fill("0.2");
    await field.press("Enter");
    await settled(page, (now) => now.edit.beta === 0.2 && now.statistics.triangles === now.triangles);
    // A better surface may follow at rest.
    const before = await rested(page);
    // Another camera pose, which must be kept too.
    await page.mouse.move(400, 400);
    await page.mouse.down();
    await page.mouse.move(520, 360, { steps: 5 });
    await page.mouse.up();
    await page.waitForFunction((pose) => JSON.stringify(window.isopeel.status.camera.position) !== pose, JSON.stringify(before.camera.position));
    await cameraAtRest(page);

    await server.stop("SIGKILL");
    await page.waitForFunction(() => window.isopeel.status.connection === "waiting");
    await page.getByText("Reconnecting").first().waitFor();
    const away = await status(page);
    assert.equal(away.triangles, before.triangles, "the surface is kept while there is no server");
    const beforeRestart = await stillPicture(page);
    await saveScreenshot(page, "server-away");

    server = await startServer([volume.path], { port: server.port });
    const now = await settled(page);
    assert.equal(now.edit.beta, 0.2);
    assert.equal(now.statistics.triangles, before.triangles);
    assert.equal(now.triangles, before.triangles);
    assert.equal(now.camera.fitted, before.camera.fitted, "the camera is not fitted again");
    const apart = Math.hypot(...now.camera.position.map((p, axis) => p - away.camera.position[axis]));
    assert.ok(apart < 1e-3, `the camera moved by ${apart} world units`);
    await saveScreenshot(page, "server-back");
    const share = difference(beforeRestart, await stillPicture(page));
    assert.ok(share < 0.001, `${(100 * share).toFixed(2)} % of the pixels differ from the picture before`);
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    await server.stop();
    volume.remove();
  }
});

/** A line to a port that can be cut without a word: nothing more comes through, and no end either. */
async function makeLine(port) {
  const sockets = [];
  const line = createServer((near) => {
    const far = connect(port, "127.0.0.1");
    for (const [from, to] of [[near, far], [far, near]]) {
      sockets.push(from);
      from.on("data", (data) => isCut || to.write(data));
      from.on("close", () => isCut || to.destroy());
      from.on("error", () => undefined);
    }
  });
  let isCut = false;
  await new Promise((done) => line.listen(0, "127.0.0.1", done));
  return {
    port: line.address().port,
    cut: (cut) => (isCut = cut),
    close: () => {
      for (const socket of sockets) socket.destroy();
      line.close();
    },
  };
}

// Within five seconds by the page's clock (web/test/heartbeat.test.ts); a busy machine runs the page late.
test("says that nothing comes through, and goes on when the line is back", { timeout: 2 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const server = await startServer([volume.path]);
  const browser = await startBrowser();
  const line = await makeLine(server.port);
  try {
    const { page, faults } = await openPage(browser, `http://127.0.0.1:${line.port}`);
    await settled(page);
    line.cut(true);
    await page.waitForFunction(() => window.isopeel.status.connection !== "connected");
    await page.getByText(/nothing has come from the server for \d+ s. Reconnecting/).waitFor();
    await saveScreenshot(page, "line-cut");
    line.cut(false);
    await settled(page);
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    line.close();
    await server.stop();
    volume.remove();
  }
});
