/** What the viewer tells a server whose processors it draws on: the demo volume, which is large enough for a coarse first picture. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { openPage, PATIENCE_MS, settled, startBrowser, startServer } from "./harness.mjs";

let server;
let browser;

before(async () => {
  server = await startServer([], { demo: true });
  browser = await startBrowser();
});

after(async () => {
  await browser?.close();
  await server?.stop();
});

test("the viewer says once that an edit's first picture is drawn, and not before it has one", { timeout: 2 * PATIENCE_MS }, async () => {
  const { page, faults } = await openPage(browser, "about:blank");
  const frames = [];
  page.on("websocket", (socket) => {
    const note = ({ payload }) => typeof payload === "string" && frames.push(JSON.parse(payload));
    socket.on("framesent", note);
    socket.on("framereceived", note);
  });
  await page.goto(server.url);
  const { generation } = await settled(page);
  await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
  const now = await settled(page, (now, before) => now.generation > before, generation);
  const ofEdit = frames.filter((frame) => frame.generation === now.generation).map(({ type }) => type);
  assert.equal(ofEdit.filter((type) => type === "drawn").length, 1, ofEdit.join());
  assert.ok(ofEdit.indexOf("drawn") > ofEdit.indexOf("committed"), ofEdit.join());
  assert.deepEqual(faults, []);
});
