/** Batch jobs from the page: the view that is shown is made for other isovalues, and the files are saved. */

import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { makeVolume, openPage, saveScreenshot, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

test("the view is submitted as a batch job, and what it has made is saved", { timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-jobs-"));
  const server = await startServer([volume.path], { options: ["--no-auth", "--state-folder", join(folder, "state")] });
  const browser = await startBrowser();
  try {
    const { page, faults } = await openPage(browser, `${server.url}/#volume=bumpy&iso=5`);
    await settled(page);
    // By the keyboard alone.
    const card = page.getByRole("region", { name: "Batch jobs" });
    await page.getByRole("button", { name: "Batch jobs" }).press("Enter");
    const isovalues = card.getByRole("textbox", { name: "Isovalues" });
    await isovalues.waitFor();
    assert.equal(await isovalues.inputValue(), "5");
    await isovalues.fill("2 x");
    await isovalues.press("Enter");
    await page.getByText("“x” is no isovalue").waitFor();
    await isovalues.fill("2, 4 6.5");
    await card.getByRole("radio", { name: "GLB" }).press("ArrowRight");
    await isovalues.press("Enter");
    const row = card.getByRole("listitem");
    // Once more is no further job.
    await page.getByText(/^The server makes 3 files/).waitFor();
    await isovalues.press("Enter");
    await page.getByText("This job is submitted already").waitFor();
    await row.getByText(/^3 files, /).waitFor();
    assert.equal(await row.count(), 1);
    await row.scrollIntoViewIfNeeded();
    await saveScreenshot(page, "jobs");
    assert.deepEqual(await violations(page), []);

    const [download] = await Promise.all([page.waitForEvent("download"), row.getByRole("button", { name: "Download bumpy" }).press("Enter")]);
    assert.match(download.suggestedFilename(), /^bumpy-[0-9a-f]{8}\.zip$/);
    const zip = readFileSync(await download.path());
    const names = [...zip.toString("latin1").matchAll(/PK\x01\x02[^]{42}(bumpy-0000[^/]+?\.ply)/g)].map(([, name]) => name);
    assert.deepEqual(names, ["bumpy-00000-2.ply", "bumpy-00001-4.ply", "bumpy-00002-6.5.ply"]);
    assert.equal(zip.toString("latin1").split("ply\nformat binary_little_endian").length, 4);

    // One that takes long is cancelled, and both are deleted.
    await isovalues.fill(Array.from({ length: 400 }, (_, n) => 1 + n / 50).join(" "));
    await isovalues.press("Enter");
    await card.getByRole("progressbar").waitFor();
    await card.getByRole("button", { name: "Cancel bumpy" }).press("Enter");
    await card.getByText(/^cancelled, /).waitFor();
    for (let count = 2; count > 0; count -= 1) {
      await card.getByRole("button", { name: "Delete bumpy" }).first().press("Enter");
      await page.waitForFunction((count) => document.querySelectorAll(".jobs li").length === count, count - 1);
    }
    assert.deepEqual(faults, []);

    // Where there are none for this user there is no card.
    await page.route("**/api/v1/session", async (route) => {
      const response = await route.fetch();
      await route.fulfill({ response, json: { ...(await response.json()), jobs: false } });
    });
    await page.reload();
    await settled(page);
    await page.getByRole("button", { name: "Follow me" }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Batch jobs" }).count(), 0);
  } finally {
    await browser.close();
    await server.stop();
    volume.remove();
    rmSync(folder, { recursive: true });
  }
});
