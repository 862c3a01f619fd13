/** Curves over time: a growing ball, whose area and volume are known. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { makeSteps, openPage, saveScreenshot, settled, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const STEPS = 4;
const at = setUp(() => makeSteps(STEPS));

test("area, volume and the value at a point are measured in all steps, and saved as a table", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=growing&iso=0&share=1&step=2&measure=r,20,20,24,0`);
  await settled(page, (now) => now.step === 2);
  await page.getByRole("button", { name: `Measure ${STEPS} steps` }).click();
  const save = page.getByRole("button", { name: "Save CSV of the curves over time" });
  await save.waitFor();
  await settled(page, (now) => now.step === 2);
  assert.ok(await page.getByRole("button", { name: "Undo" }).getAttribute("aria-disabled"), "what was measured is no step of the history");
  const download = page.waitForEvent("download");
  await save.click();
  const file = await download;
  assert.equal(file.suggestedFilename(), "growing-over-time.csv");
  const [head, ...rows] = readFileSync(await file.path(), "utf8").trim().split("\r\n").map((line) => line.split(","));
  assert.deepEqual(head.slice(0, 3), ["volume", "step", "time"]);
  assert.equal(rows.length, STEPS);
  rows.forEach(([volume, step, time, area, enclosed, border, value], i) => {
    const radius = 8 + i;
    assert.deepEqual([volume, step, time, border], ["growing", String(i + 1), `step ${10 + i}`, "0"]);
    assert.ok(Math.abs(Number(area) / (4 * Math.PI * radius ** 2) - 1) < 0.02, `area ${area} of radius ${radius}`);
    assert.ok(Math.abs(Number(enclosed) / ((4 / 3) * Math.PI * radius ** 3) - 1) < 0.02, `volume ${enclosed} of radius ${radius}`);
    assert.ok(Math.abs(Number(value) - (radius - 4)) < 0.01, `value ${value} of radius ${radius}`);
  });
  // A click on a curve goes to the step there.
  const curve = page.locator(".time-curve svg").first();
  const { width, height } = await curve.boundingBox();
  await curve.click({ position: { x: width - 10, y: height / 2 } });
  await settled(page, (now) => now.step === 3);
  for (const theme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme: theme });
    await page.locator(`html[data-theme=${theme}]`).waitFor();
    assert.deepEqual(await violations(page), [], theme);
    await saveScreenshot(page, `time-curves-${theme}`);
  }
  assert.deepEqual(faults, []);
  await page.context().close();
});
