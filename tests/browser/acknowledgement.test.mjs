/** Acknowledgement (`drawn`) of a first prefix, with a surface that takes longer than the picture of that. */

import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { openPage, settled, startBrowser, startServer, TIMEOUT_MS, writeVolume } from "./harness.mjs";

let folder;
let server;
let browser;

before(async () => {
  folder = mkdtempSync(join(tmpdir(), "isopeel-"));
  server = await startServer([writeVolume(folder, 256)]);
  browser = await startBrowser();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  if (folder) rmSync(folder, { recursive: true });
});

/** On a busy machine the server may be done before the first frame is rendered; nothing is acknowledged then. */
const TRIES = 20;

test("an edit's first coarse frame is acknowledged once, after its prefix was committed and before the server is done", { timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, faults, messages } = await openPage(browser, server.url);
  let { generation } = await settled(page);
  for (let tries = 0, acknowledged = 0; acknowledged === 0; tries += 1) {
    assert.ok(tries < TRIES, `${tries} edits without an acknowledgement`);
    await page.getByRole("slider", { name: "Isovalue" }).press(tries % 2 === 0 ? "ArrowRight" : "ArrowLeft");
    ({ generation } = await settled(page, (now, before) => now.generation > before, generation));
    const ofEdit = messages.filter((message) => message.generation === generation).map(({ type }) => type);
    acknowledged = ofEdit.filter((type) => type === "drawn").length;
    assert.ok(acknowledged <= 1, ofEdit.join());
    if (acknowledged === 0) continue;
    assert.ok(ofEdit.indexOf("drawn") > ofEdit.indexOf("committed"), ofEdit.join());
    assert.ok(!ofEdit.slice(0, ofEdit.indexOf("drawn")).includes("done"), ofEdit.join());
  }
  assert.deepEqual(faults, []);
});
