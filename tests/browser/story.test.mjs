/** Bookmarks with sentences: made, played with a moving camera, saved and opened, recorded. */

import assert from "node:assert/strict";
import { readFileSync, statSync } from "node:fs";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { openPage, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();
const FAR = "camera=25,120,22,25,23,22";
const NEAR = "camera=-10,23,60,25,23,22";
const FILE = {
  format: "isopeel-story",
  version: 1,
  bookmarks: [
    { text: "From the front", state: `v=1&volume=bumpy&iso=0&${FAR}` },
    { text: "Smaller", state: `v=1&volume=bumpy&iso=6&${NEAR}` },
  ],
};
const asFile = (content) => ({ name: "tour.json", mimeType: "application/json", buffer: Buffer.from(content) });
const sentence = (page, number) => page.getByRole("textbox", { name: `Sentence of bookmark ${number}` });
const unfold = (page) => page.getByRole("button", { name: "Story", exact: true }).and(page.locator(".card-head")).click();

test("bookmarks are made, changed, saved, opened and deleted", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=bumpy&iso=0`);
  await settled(page);
  await unfold(page);
  await page.getByRole("button", { name: "Add bookmark" }).click();
  await sentence(page, 1).fill("The whole ball");
  await sentence(page, 1).press("Enter");
  await page.getByRole("textbox", { name: "Isovalue" }).fill("5");
  await page.keyboard.press("Enter");
  await settled(page, (now) => now.edit.iso === 5);
  await page.getByRole("button", { name: "Add bookmark" }).click();
  await page.getByRole("button", { name: "Move bookmark 2 up" }).click();
  assert.equal(await sentence(page, 2).inputValue(), "The whole ball");
  await page.waitForFunction(() => window.location.hash.includes("story="));
  for (const theme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme: theme });
    await page.locator(`html[data-theme=${theme}]`).waitFor();
    assert.deepEqual(await violations(page), [], theme);
  }
  await page.getByRole("button", { name: "Show bookmark 2" }).click();
  await settled(page, (now) => now.edit.iso === 0);
  const download = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save story" }).click();
  const file = await download;
  assert.equal(file.suggestedFilename(), "bumpy-story.json");
  const saved = JSON.parse(readFileSync(await file.path(), "utf8"));
  assert.deepEqual(saved.bookmarks.map(({ text }) => text), ["", "The whole ball"]);
  await page.getByRole("button", { name: "Delete bookmark 1" }).click();
  await sentence(page, 2).waitFor({ state: "detached" });
  await page.getByRole("button", { name: "Undo", exact: true }).last().click();
  await sentence(page, 2).waitFor();
  // A link has the story; one of before leaves it.
  await page.waitForFunction(() => window.location.hash.split("~~").length === 2);
  await page.reload();
  await settled(page);
  await unfold(page);
  assert.equal(await sentence(page, 2).inputValue(), "The whole ball");
  const input = page.getByLabel("File of a story");
  await input.setInputFiles(asFile("{}"));
  await page.getByText("tour.json: The file is no story: its “format” is missing, expected \"isopeel-story\"").waitFor();
  await input.setInputFiles(asFile(JSON.stringify(FILE)));
  await page.waitForFunction(() => document.querySelector(".bookmarks input")?.value === "From the front");
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("a story is played with a moving camera, and recorded", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=bumpy&iso=0`);
  await settled(page);
  await unfold(page);
  await page.getByLabel("File of a story").setInputFiles(asFile(JSON.stringify(FILE)));
  await page.getByRole("button", { name: "Play", exact: true }).click();
  await page.locator(".telling").getByText("From the front").waitFor();
  await page.locator(".telling").getByText("Smaller").waitFor();
  await settled(page, (now) => now.edit.iso === 6);
  await saveScreenshot(page, "story-telling");
  // On its way between the two bookmarks.
  const ways = new Set();
  for (let i = 0; i < 100 && (await page.locator(".telling").count()) > 0; i += 1) {
    ways.add(JSON.stringify((await status(page)).camera.position));
    await new Promise((done) => setTimeout(done, 50));
  }
  assert.ok(ways.size > 4, `${ways.size} positions of the camera`);
  await page.locator(".telling").waitFor({ state: "detached" });
  assert.deepEqual((await status(page)).camera.position.map(Math.round), [-10, 23, 60]);

  const download = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save video" }).click();
  const video = await download;
  assert.equal(video.suggestedFilename(), "story.webm");
  const path = await video.path();
  // EBML's mark.
  assert.equal(readFileSync(path).readUInt32BE(0), 0x1a45dfa3);
  assert.ok(statSync(path).size > 10_000, `${statSync(path).size} bytes`);
  await page.getByRole("button", { name: "Play", exact: true }).click();
  await page.locator(".telling").getByRole("button", { name: "Stop" }).click();
  await page.locator(".telling").waitFor({ state: "detached" });
  assert.deepEqual(faults, []);
  await page.context().close();
});
