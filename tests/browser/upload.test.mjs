/** Volumes that the user brings: dropped on the page, sent with progress over a connection that fails, shown, removed; and what is said where none are taken. */

import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { makeBalls, makeVolume, openPage, saveScreenshot, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

/** Drags a file over the page and, if `release`, drops it. */
const drag = (page, name, base64, release) =>
  page.evaluate(
    ([name, base64, release]) => {
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))], name, { lastModified: 1 }));
      const send = (type) => document.querySelector("main").dispatchEvent(new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
      send("dragenter");
      if (release) send("drop");
    },
    [name, base64, release],
  );

test("a file that is dropped is uploaded, shown, and removed again", { timeout: 4 * TIMEOUT_MS }, async () => {
  const [volume, balls] = [makeVolume(), makeBalls()];
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-uploads-"));
  const bytes = readFileSync(balls.path).toString("base64");
  const server = await startServer([volume.path], { options: ["--no-auth", "--uploads", folder] });
  const browser = await startBrowser();
  try {
    const { page, faults } = await openPage(browser, server.url);
    await settled(page);
    // The first part is held, then its connection is lost; the next one comes through.
    let [release, parts] = [() => undefined, 0];
    const held = new Promise((done) => (release = done));
    await page.route("**/api/v1/uploads/*", async (route) => {
      if (route.request().method() !== "PATCH") return route.continue();
      parts += 1;
      if (parts > 1) return route.continue();
      await held;
      await route.abort("connectionreset").catch(() => undefined);
    });
    await drag(page, "balls.npy", bytes, false);
    await page.getByText("Drop files or a folder").waitFor();
    await saveScreenshot(page, "upload-drop");
    await drag(page, "balls.npy", bytes, true);
    const progress = page.getByRole("group", { name: "Upload of balls.npy" });
    await progress.getByText("Uploading balls.npy").first().waitFor();
    assert.equal(await page.getByText("Drop files or a folder").count(), 0);
    await saveScreenshot(page, "upload-progress");
    assert.deepEqual(await violations(page, ".upload"), []);
    release();
    // The picture is that of the file.
    const now = await page.waitForFunction(() => {
      const { volume, settled, triangles } = window.isopeel.status;
      return settled && triangles > 0 && volume.startsWith("upload-") && window.isopeel.status;
    });
    const { volume: id } = await now.jsonValue();
    assert.match(id, /^upload-[0-9a-f]{32}$/);
    assert.ok(parts >= 2, "the lost part was sent again");
    assert.equal(await page.title(), "balls · isopeel");
    await progress.waitFor({ state: "detached" });
    await saveScreenshot(page, "upload-shown");

    // Another one is cancelled, and nothing of it stays.
    await page.unroute("**/api/v1/uploads/*");
    await page.route("**/api/v1/uploads/*", async (route) => {
      if (route.request().method() === "PATCH") return;
      await route.continue();
    });
    await drag(page, "other.npy", bytes, true);
    await page.getByRole("group", { name: "Upload of other.npy" }).getByRole("button", { name: "Cancel" }).click();
    await page.getByText("The upload of other.npy was cancelled").waitFor();
    const kept = await (await fetch(`${server.url}/api/v1/uploads`)).json();
    assert.deepEqual(kept.uploads.map(({ title, state }) => [title, state]), [["balls.npy", "ready"]]);

    // The dialog lists it, and removes it; the page goes on with what is there.
    await page.getByRole("button", { name: "Your volumes: upload files" }).click();
    const dialog = page.getByRole("dialog", { name: "Your volumes" });
    await dialog.getByText("balls.npy").waitFor();
    assert.deepEqual(await violations(page, ".dialog"), []);
    await saveScreenshot(page, "upload-dialog");
    await dialog.getByRole("button", { name: "Remove balls.npy" }).click();
    await dialog.getByText("Nothing yet.").waitFor();
    await dialog.getByRole("button", { name: "Close" }).click();
    await page.waitForFunction(() => window.isopeel.status.volume === "bumpy" && window.isopeel.status.settled);
    await page.getByText("“balls” was removed from the server").waitFor();
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    await server.stop();
    for (const made of [volume, balls]) made.remove();
    rmSync(folder, { recursive: true });
  }
});

test("a server that takes no uploads says so when something is dropped", { timeout: 2 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const server = await startServer([volume.path]);
  const browser = await startBrowser();
  try {
    const { page, faults } = await openPage(browser, server.url);
    await settled(page);
    await drag(page, "a.npy", btoa("nothing"), true);
    await page.getByText("a.npy could not be uploaded: uploads are disabled on this server").waitFor();
    await page.getByRole("button", { name: "Your volumes: upload files" }).click();
    await page.getByText("Uploads are disabled on this server (--uploads DIR)").waitFor();
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    await server.stop();
    volume.remove();
  }
});
