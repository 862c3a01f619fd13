/** Labels as objects: surfaces, importance and masks by a click each, what a link keeps, and a list of thousands. */

import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { MORE, openPage, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const DIMS = [64, 56, 48];
const HIGHEST = 1200;
/** Middle, radius and number of labels within a head. */
const BALLS = [
  [[20, 28, 24], 9, 3],
  [[44, 28, 24], 7, 17],
  [[32, 44, 24], 6, 1000],
];

/** An NRRD of 16-bit numbers. */
function nrrd(value) {
  const header = Buffer.from(`NRRD0004\ntype: uint16\ndimension: 3\nsizes: ${DIMS.join(" ")}\nspacings: 1 1 1\nencoding: raw\nendian: little\n\n`);
  const samples = Buffer.alloc(2 * DIMS[0] * DIMS[1] * DIMS[2]);
  let at = 0;
  for (let z = 0; z < DIMS[2]; z += 1) for (let y = 0; y < DIMS[1]; y += 1) for (let x = 0; x < DIMS[0]; x += 1) at = samples.writeUInt16LE(value([x, y, z]), at);
  return Buffer.concat([header, samples]);
}

/** Balls, and a plane in which each label has a sample. */
function labelAt(place) {
  const [x, y, z] = place;
  const number = 1 + x + DIMS[0] * y;
  if (z === 1) return number <= HIGHEST ? number : 0;
  return BALLS.find(([middle, radius]) => distance(place, middle) <= radius)?.[2] ?? 0;
}

const distance = (a, b) => Math.hypot(...a.map((x, axis) => x - b[axis]));

/** A head and labels within it as two fields, and the labels alone, with a table of many names. */
function makeHead() {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-"));
  const labels = nrrd(labelAt);
  const names = { 3: "Left Hippocampus", 17: "Pons", 1000: "Frontal pole" };
  const rows = Array.from({ length: HIGHEST }, (_, i) => `${i + 1}\t${names[i + 1] ?? `Region ${i + 1}`}\t${i + 1 === 3 ? "#ff8040" : "#4060c0"}`);
  const table = `index\tname\tcolor\n${rows.join("\n")}\n`;
  for (const [name, files] of [["head", { "t1.nrrd": nrrd((at) => Math.max(0, Math.round(1000 - 30 * distance(at, [32, 28, 24])))), "atlas.nrrd": labels, "atlas.tsv": table }], ["alone", { "atlas.nrrd": labels, "atlas.tsv": table }]]) {
    mkdirSync(join(folder, name));
    for (const [file, bytes] of Object.entries(files)) writeFileSync(join(folder, name, file), bytes);
  }
  return { paths: [join(folder, "head"), join(folder, "alone")], remove: () => rmSync(folder, { recursive: true }) };
}

const at = setUp(makeHead);
const SIZE = { viewport: { width: 1400, height: 900 } };

async function openLabels(hash, options = {}) {
  const opened = await openPage(at.browser, `${at.server.url}/#${hash}`, { ...SIZE, ...options });
  await rested(opened.page);
  await opened.page.getByRole("button", { name: /^Labels( surface \d)?$/ }).click();
  const card = opened.page.getByRole("region", { name: "Labels", exact: true });
  await card.getByRole("grid").waitFor();
  return { ...opened, card };
}

test("surfaces of labels are shown, measured and hidden, and importance and a mask follow labels", { ...MORE, timeout: 6 * TIMEOUT_MS }, async () => {
  const { page, card, faults } = await openLabels("volume=head&iso=500&share=0.6");
  await card.getByRole("searchbox", { name: "Search labels" }).fill("hippo");
  await card.getByRole("button", { name: "Surface of Left Hippocampus" }).press("Enter");
  await settled(page, ({ surfaces }) => surfaces.length === 2);
  const [head, label] = (await status(page)).surfaces;
  assert.equal(label.edit.field, "smooth(0.8,atlas==3)");
  assert.deepEqual([label.style.color, head.style.opacity], ["#ff8040", 0.35]);
  assert.ok(label.triangles > 0, "it is there");
  await rested(page);
  await card.getByRole("button", { name: "Compute" }).click();
  const row = card.getByRole("row", { name: /^Left Hippocampus [\d,]/ });
  await row.waitFor();
  const [volume, area] = (await row.getByRole("cell").allInnerTexts()).map((text) => Number(/^[\d.,]+/.exec(text)[0].replaceAll(",", "")));
  // Samples fill a cell each: the ball is about half a cell larger than its radius says, less what the smoothing takes.
  assert.ok(Math.abs(volume / ((4 / 3) * Math.PI * 9 ** 3) - 1) < 0.1, `${volume}`);
  assert.ok(Math.abs(area / (4 * Math.PI * 9 ** 2) - 1) < 0.1, `${area}`);
  await saveScreenshot(page, "labels");
  assert.deepEqual(await violations(page), []);

  await card.getByRole("button", { name: "Importance falls with the distance to Left Hippocampus" }).click();
  await settled(page, ({ edit }) => edit.feature === "distance(atlas==3)" && edit.alpha === 1);
  await card.getByRole("searchbox").fill("pons");
  await card.getByRole("button", { name: "Importance falls with the distance to Pons" }).click();
  await settled(page, ({ edit }) => edit.feature === "distance(atlas==3,17)");
  await card.getByRole("button", { name: "Restrict the surface to Pons" }).click();
  await settled(page, ({ edit }) => edit.mask === "atlas==17");
  await page.waitForFunction(() => decodeURIComponent(location.hash).includes("mask=atlas==17"));
  const again = await openLabels(new URL(page.url()).hash.slice(1));
  const now = await status(again.page);
  assert.deepEqual([now.edit.feature, now.edit.mask, now.surfaces[1].edit.field], ["distance(atlas==3,17)", "atlas==17", "smooth(0.8,atlas==3)"]);
  await again.card.getByRole("searchbox").fill("3");
  assert.equal(await again.card.getByRole("button", { name: "Surface of Left Hippocampus" }).getAttribute("aria-pressed"), "true");
  await again.page.close();

  await card.getByRole("button", { name: "Restrict the surface to Pons" }).click();
  await settled(page, ({ edit }) => edit.mask === null);
  await card.getByRole("searchbox").fill("hippo");
  await card.getByRole("button", { name: "Surface of Left Hippocampus" }).click();
  await page.waitForFunction(() => window.isopeel.status.surfaces[1].style.visible === false);
  await card.getByText("Smooth surfaces").click();
  await settled(page, ({ surfaces }) => surfaces[1].edit.field === 'if("atlas"==3,1,0)');
  assert.deepEqual([...faults, ...again.faults], []);
  await page.close();
});

test("where only labels are open there is no mask, and all surfaces that there can be are of labels", { ...MORE, timeout: 6 * TIMEOUT_MS }, async () => {
  const { page, card, faults } = await openLabels("volume=alone", { colorScheme: "light" });
  assert.equal(await card.getByRole("button", { name: /^Restrict/ }).count(), 0);
  // Of 1200 labels some rows are in the page; keys bring the others.
  assert.equal(await card.getByRole("grid").getAttribute("aria-rowcount"), String(HIGHEST));
  assert.ok((await card.getByRole("grid").getByRole("row").count()) < 30);
  const first = card.getByRole("button", { name: "Surface of Region 1", exact: true });
  await first.focus();
  await page.keyboard.press("End");
  assert.equal(await page.evaluate(() => document.activeElement.getAttribute("aria-label")), "Surface of Region 1200");
  await page.keyboard.press("ArrowRight");
  assert.equal(await page.evaluate(() => document.activeElement.getAttribute("aria-label")), "Importance falls with the distance to Region 1200");
  await page.keyboard.press("Home");
  assert.equal(await page.evaluate(() => document.activeElement.getAttribute("aria-label")), "Importance falls with the distance to Region 1");
  assert.equal(await card.locator('[role="grid"] button[tabindex="0"]').count(), 1, "Tab stops once");
  const max = 4;
  for (const [name, count] of [["Hippocampus", 2], ["Pons", 3], ["Frontal pole", 4]]) {
    await card.getByRole("searchbox").fill(name);
    await card.getByRole("button", { name: new RegExp(`^Surface of .*${name}`) }).click();
    await settled(page, ({ surfaces }, count) => surfaces.length === count, count);
  }
  assert.equal((await status(page)).surfaces.length, max);
  await card.getByRole("searchbox").fill("Region 5");
  await card.getByRole("button", { name: "Surface of Region 5", exact: true }).click();
  await page.getByRole("button", { name: "Show", exact: true }).click();
  await settled(page, ({ surfaces }) => surfaces[3].edit.field === "smooth(0.8,atlas==1000,5)");
  await saveScreenshot(page, "labels-alone");
  assert.deepEqual(await violations(page), []);
  await card.getByRole("searchbox").fill("nothing");
  await card.getByText("No label has this name or number").waitFor();
  assert.deepEqual(faults, []);
  await page.close();
});
