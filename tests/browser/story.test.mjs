/** Bookmarks with sentences: made, played with a moving camera, saved and opened, recorded. */

import assert from "node:assert/strict";
import { readFileSync, statSync } from "node:fs";
import { test } from "node:test";
import { PNG } from "pngjs";
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

/** Its length in seconds, as the browser plays it; in a page without a policy. */
async function playable(bytes) {
  const page = await at.browser.newPage();
  const seconds = await page.evaluate(
    (base64) =>
      new Promise((done, failed) => {
        const video = document.createElement("video");
        video.onloadeddata = () => done(video.duration);
        video.onerror = () => failed(new Error(`not playable: ${video.error?.message}`));
        const blob = new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))], { type: "video/mp4" });
        video.src = URL.createObjectURL(blob);
      }),
    bytes.toString("base64"),
  );
  await page.close();
  return seconds;
}

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
  await page.setViewportSize({ width: 820, height: 760 });
  const [list, button] = await Promise.all([page.locator(".bookmarks"), page.getByRole("button", { name: "Delete bookmark 1" })].map((of) => of.boundingBox()));
  assert.ok(button.x + button.width <= list.x + list.width + 1, "a button is outside of a narrow column");
  await page.waitForFunction(() => window.location.hash.includes("story="));
  for (const theme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme: theme });
    await page.locator(`html[data-theme=${theme}]`).waitFor();
    assert.deepEqual(await violations(page), [], theme);
  }
  await page.getByRole("button", { name: "Show bookmark 2" }).click();
  await settled(page, (now) => now.edit.iso === 0);
  const download = page.waitForEvent("download", { timeout: 3 * TIMEOUT_MS });
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

test("a story is played with a moving camera, and recorded", { timeout: 6 * TIMEOUT_MS }, async () => {
  // Small, because software draws hundreds of frames.
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=bumpy&iso=0`, { viewport: { width: 780, height: 420 } });
  await settled(page);
  await unfold(page);
  await page.getByLabel("File of a story").setInputFiles(asFile(JSON.stringify(FILE)));
  await page.getByRole("button", { name: "Play", exact: true }).click();
  await page.locator(".telling").getByText("From the front").waitFor();
  await page.locator(".telling").getByText("Smaller").waitFor();
  await page.waitForFunction(() => window.isopeel.status.edit.iso === 6);
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

  const made = page.waitForEvent("download", { timeout: 3 * TIMEOUT_MS });
  await page.getByRole("button", { name: "Save the story as MP4" }).click();
  const mp4 = await made;
  assert.equal(mp4.suggestedFilename(), "story.mp4");
  const seconds = await playable(readFileSync(await mp4.path()));
  // Two sentences of 2.5 s at least, and moves of 1 s and 2 s.
  assert.ok(seconds > 7 && seconds < 10, `${seconds} s`);

  // One bookmark is enough for the others; a WebM takes as long as its story.
  await page.getByRole("button", { name: "Delete bookmark 2" }).click();
  const download = page.waitForEvent("download", { timeout: 3 * TIMEOUT_MS });
  await page.getByRole("button", { name: "Save the story as WebM" }).click();
  const video = await download;
  assert.equal(video.suggestedFilename(), "story.webm");
  const path = await video.path();
  // EBML's mark.
  assert.equal(readFileSync(path).readUInt32BE(0), 0x1a45dfa3);
  assert.ok(statSync(path).size > 10_000, `${statSync(path).size} bytes`);

  const zipped = page.waitForEvent("download", { timeout: 3 * TIMEOUT_MS });
  await page.getByRole("button", { name: "Save the story as PNGs" }).click();
  const zip = await zipped;
  assert.equal(zip.suggestedFilename(), "story.zip");
  const bytes = readFileSync(await zip.path());
  const text = bytes.toString("latin1");
  // Of the zip's directory: files are stored as they are.
  const names = [...text.matchAll(/PK\x01\x02[^]{42}(\d{4}\.png|story\.ffconcat)/g)].map(([, name]) => name);
  assert.deepEqual([names[0], names.at(-1)], ["0000.png", "story.ffconcat"]);
  // A move of 1 s has 25 images, and the rest has one.
  assert.equal(names.length, 25 + 1 + 1);
  assert.match(text, /ffconcat version 1\.0\nfile '0000\.png'\nduration 0\.04\n/);
  assert.equal([...text.matchAll(/\nduration \d/g)].length, names.length - 1);
  const first = text.indexOf("\x89PNG");
  const image = PNG.sync.read(bytes.subarray(first, text.indexOf("IEND", first) + 8));
  const { width, height } = await page.locator(".viewport canvas").first().boundingBox();
  assert.deepEqual([image.width, image.height], [2 * Math.round(width / 2), 2 * Math.round(height / 2)]);
  await page.getByRole("button", { name: "Play", exact: true }).click();
  await page.locator(".telling").getByRole("button", { name: "Stop" }).click();
  await page.locator(".telling").waitFor({ state: "detached" });
  assert.deepEqual(faults, []);
  await page.context().close();
});
