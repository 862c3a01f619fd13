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

/** A busy machine draws the picture when the server is done already, and the viewer then rightly says nothing. */
const TRIES = 20;

test("the viewer says once that an edit's first picture is drawn, and not before it has one", { timeout: 2 * PATIENCE_MS }, async () => {
  const { page, faults, messages } = await openPage(browser, server.url);
  let { generation } = await settled(page);
  for (let tries = 0, told = 0; told === 0; tries += 1) {
    assert.ok(tries < TRIES, `${tries} edits, and never a word`);
    await page.getByRole("slider", { name: "Isovalue" }).press(tries % 2 === 0 ? "ArrowRight" : "ArrowLeft");
    ({ generation } = await settled(page, (now, before) => now.generation > before, generation));
    const ofEdit = messages.filter((message) => message.generation === generation).map(({ type }) => type);
    told = ofEdit.filter((type) => type === "drawn").length;
    assert.ok(told <= 1, ofEdit.join());
    if (told === 0) continue;
    assert.ok(ofEdit.indexOf("drawn") > ofEdit.indexOf("committed"), ofEdit.join());
    assert.ok(!ofEdit.slice(0, ofEdit.indexOf("drawn")).includes("done"), ofEdit.join());
  }
  assert.deepEqual(faults, []);
});
