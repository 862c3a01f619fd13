/** Colours of a field are the field's values at these points: of labels, where samples are missing, in each time step. */

import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { describe, test } from "node:test";
import { MORE, npy, openPage, rested, settled, stillPicture, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const SIZE = 40;
/** Two time steps of a ball, labels 1 and 7 in its halves, a value without samples in its upper half, and one that is another in each step. */
function makeValues() {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-"));
  const path = join(folder, "values");
  mkdirSync(path);
  const fields = {
    ball: () => (...at) => 14 - Math.hypot(...at.map((x) => x - 20)),
    label: () => (x) => (x < 20 ? 1 : 7),
    partial: () => (_x, _y, z) => (z < 20 ? 1 : NaN),
    tide: (step) => () => step,
  };
  for (const [name, of] of Object.entries(fields)) for (const step of [0, 1]) writeFileSync(join(path, `${name}_0${step}.npy`), npy([SIZE, SIZE, SIZE], of(step)));
  return { path, remove: () => rmSync(folder, { recursive: true }) };
}

const at = setUp(makeValues);
const open = (field, range) => openPage(at.browser, `${at.server.url}/#v=1&volume=values&field=ball&iso=3&color=field&colorField=${field}&colors=${range}&map=viridis&background=white`);

/** Shares of the surface's pixels that have the lowest colour of the map, dark violet, the highest, yellow, any other, and that are grey. */
function shares({ data }) {
  const counts = { low: 0, high: 0, other: 0, grey: 0 };
  let all = 0;
  for (let i = 0; i < data.length; i += 4) {
    const [r, g, b] = data.subarray(i, i + 3);
    if (Math.min(r, g, b) > 245) continue;
    all += 1;
    if (Math.max(r, g, b) - Math.min(r, g, b) < 24) counts.grey += 1;
    else if (Math.min(r, b) > g) counts.low += 1;
    else if (r > g && g > 2 * b) counts.high += 1;
    else counts.other += 1;
  }
  return Object.fromEntries(Object.entries(counts).map(([name, count]) => [name, count / all]));
}

describe("values of a field", { timeout: 3 * TIMEOUT_MS }, () => {
  test("labels have their colours, and only a seam between them has others", MORE, async () => {
    const { page, faults } = await open("label", "1,7");
    await rested(page);
    const { low, high, other, grey } = shares(await stillPicture(page));
    assert.ok(low > 0.6 && high > 0.05 && other < 0.15 && grey < 0.01, JSON.stringify({ low, high, other, grey }));
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("a surface is grey where samples are missing", MORE, async () => {
    const { page, faults } = await open("partial", "0,1");
    await rested(page);
    const { low, high, other, grey } = shares(await stillPicture(page));
    assert.ok(grey > 0.6 && high > 0.1 && low + other < 0.01, JSON.stringify({ low, high, other, grey }));
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("colours are those of the time step, whose surface is the same", async () => {
    const { page, faults } = await open("tide", "0,1");
    const first = await rested(page);
    assert.ok(shares(await stillPicture(page)).low > 0.98);
    await page.getByRole("slider", { name: "Time step", exact: true }).press("ArrowRight");
    await settled(page, (now) => now.step === 1);
    const second = await rested(page);
    assert.ok(shares(await stillPicture(page)).high > 0.98);
    assert.equal(second.triangles, first.triangles);
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("another field takes the place of a field, in its colours", async () => {
    const { page, faults } = await open("tide", "0,1");
    await rested(page);
    await page.getByRole("combobox", { name: "Field of the colours" }).selectOption("partial");
    await settled(page, (now) => now.edit.colorField === "partial");
    await rested(page);
    // Its only value is the lowest of its own range.
    const { low, grey } = shares(await stillPicture(page));
    assert.ok(grey > 0.6 && low > 0.1, JSON.stringify({ low, grey }));
    assert.deepEqual(faults, []);
    await page.context().close();
  });
});
