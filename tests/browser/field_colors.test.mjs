/** Colours of a field in its units: the legend whose ends are moved, a log scale, isolines; in links and images. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { describe, test } from "node:test";
import { PNG } from "pngjs";
import { violations } from "./accessibility.mjs";
import { difference, openPage, picture, rested, saveScreenshot, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();
const FIELD = "#v=1&volume=bumpy&iso=3&feature=height&color=field&map=viridis&background=white";
const open = (more = "") => openPage(at.browser, `${at.server.url}/${FIELD}${more}`);
const inAddress = (page, text) => page.waitForFunction((text) => window.location.hash.includes(text), text);
const end = (page, name) => page.getByRole("textbox", { name, exact: true });

/** An image as it is saved. */
async function saved(page) {
  const download = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save PNG" }).click();
  return PNG.sync.read(readFileSync(await (await download).path()));
}

describe("colours of a field", { timeout: 4 * TIMEOUT_MS }, () => {
  test("the ends of the legend are dragged, moved by keys, typed, and reset; each is one step of the history", async () => {
    const { page, faults } = await open();
    await rested(page);
    const high = page.getByRole("slider", { name: "Highest colour" });
    await high.waitFor();
    assert.equal(await end(page, "Highest colour").inputValue(), "43");
    const before = await picture(page);
    const box = await high.boundingBox();
    const bar = await page.locator(".field-bar").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2 + bar.height / 4, { steps: 4 });
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2 + bar.height / 2, { steps: 4 });
    await page.mouse.up();
    const dragged = Number(await end(page, "Highest colour").inputValue());
    assert.ok(Math.abs(dragged - 21.5) < 1.5, `${dragged}`);
    await inAddress(page, "colors=0,2");
    assert.ok(difference(before, await picture(page)) > 0.05, "the surface has other colours");
    await high.focus();
    await page.keyboard.press("ArrowUp");
    assert.ok(Number(await end(page, "Highest colour").inputValue()) > dragged);
    await end(page, "Lowest colour").fill("12");
    await page.keyboard.press("Enter");
    await inAddress(page, "colors=12,");
    // An end does not pass the other one.
    await end(page, "Lowest colour").fill("99");
    await page.keyboard.press("Enter");
    assert.ok(Number(await end(page, "Lowest colour").inputValue()) < Number(await end(page, "Highest colour").inputValue()));
    for (const theme of ["dark", "light"]) {
      await page.emulateMedia({ colorScheme: theme });
      await page.locator(`html[data-theme=${theme}]`).waitFor();
      assert.deepEqual(await violations(page), [], theme);
      await saveScreenshot(page, `field-colors-${theme}`);
    }
    await page.emulateMedia({ colorScheme: "dark" });
    await page.getByRole("button", { name: "Reset range of the colours" }).click();
    assert.equal(await end(page, "Highest colour").inputValue(), "43");
    // A busy machine draws a few frames in lower quality.
    for (let i = 0; i < 20 && difference(before, await picture(page)) >= 0.002; i += 1) await page.waitForTimeout(200);
    assert.ok(difference(before, await picture(page)) < 0.002, "as before");
    for (let i = 0; i < 4; i += 1) await page.getByRole("button", { name: "Undo" }).click();
    assert.equal(Number(await end(page, "Highest colour").inputValue()), dragged);
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("the range can be that of the surface", async () => {
    const { page } = await open();
    await rested(page);
    await page.getByRole("button", { name: "Range of the surface" }).click();
    // The ball has a radius of 12, and a little more on one half, around the middle of 44 samples.
    await page.waitForFunction(() => {
      const [, low, high] = /colors=([\d.]+),([\d.]+)/.exec(window.location.hash) ?? [];
      return Number(low) > 7 && Number(low) < 11 && Number(high) > 33 && Number(high) < 37;
    });
    await page.context().close();
  });

  test("any field and any expression colours the surface, and changes no triangle of it", async () => {
    const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=bumpy&iso=3&feature=none&map=viridis&background=white`);
    const plain = await rested(page);
    const before = await picture(page);
    const look = page.getByRole("region", { name: "Look", exact: true });
    await look.getByText("Field", { exact: true }).first().click();
    // No field is the importance, so one is chosen.
    const fields = look.getByRole("combobox", { name: "Field of the colours" });
    await fields.waitFor();
    assert.equal(await fields.inputValue(), "height");
    await inAddress(page, "colorField=height");
    const colored = await rested(page);
    const height = await picture(page);
    assert.ok(difference(before, height) > 0.05, "the surface has colours");
    assert.deepEqual([colored.triangles, colored.edit.feature], [plain.triangles, "none"]);
    await page.getByRole("group", { name: "Colours of height" }).waitFor();
    assert.equal(await end(page, "Highest colour").inputValue(), "43");
    await page.getByRole("button", { name: "Range of the surface" }).click();
    await page.waitForFunction(() => {
      const [, low, high] = /colors=([\d.]+),([\d.]+)/.exec(window.location.hash) ?? [];
      return Number(low) > 7 && Number(low) < 11 && Number(high) > 33 && Number(high) < 37;
    });
    for (const theme of ["dark", "light"]) {
      await page.emulateMedia({ colorScheme: theme });
      await page.locator(`html[data-theme=${theme}]`).waitFor();
      assert.deepEqual(await violations(page), [], theme);
      await saveScreenshot(page, `any-field-colors-${theme}`);
    }

    // The upper half, then the same as an expression: a range of its own, and the same colours.
    await look.getByRole("button", { name: "Colour by an expression" }).click();
    const text = look.getByRole("textbox", { name: "Expression of the colours" });
    await text.fill("100 - 2 * height");
    await look.getByText(/^Values from /).waitFor();
    await text.press("Enter");
    await page.waitForFunction(() => window.isopeel.status.edit.colorField === "100 - 2 * height");
    const computed = await rested(page);
    assert.equal(computed.triangles, plain.triangles);
    assert.deepEqual([await end(page, "Lowest colour").inputValue(), await end(page, "Highest colour").inputValue()], ["14", "100"]);
    assert.ok(difference(height, await picture(page)) > 0.05, "the colours are reversed");
    const again = await openPage(at.browser, page.url());
    const linked = await rested(again.page);
    assert.deepEqual([linked.edit.colorField, linked.triangles], ["100 - 2 * height", plain.triangles], "the link brings it");
    await again.page.context().close();
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("a log scale says what becomes of 0; isolines are in the picture, the legend and saved images", async () => {
    const { page, faults } = await open("&colors=0,43");
    await rested(page);
    await page.getByRole("button", { name: "Export", exact: true }).click();
    const plain = { seen: await picture(page), saved: await saved(page) };
    await page.getByRole("switch", { name: "Log scale" }).press("Space");
    await page.getByText("Only values above 0 have a logarithm: the colours begin at 0.043").waitFor();
    await page.getByRole("switch", { name: "Log scale" }).press("Space");
    await page.getByRole("switch", { name: "Isolines" }).press("Space");
    await page.getByText("At 5, 10, 15, 20, 25, 30, 35, 40").waitFor();
    await inAddress(page, "isolines=8");
    assert.deepEqual(await page.locator(".field-line").allInnerTexts(), ["5", "10", "15", "20", "25", "30", "35", ""]);
    const share = difference(plain.seen, await picture(page), 40);
    assert.ok(share > 0.002 && share < 0.05, `lines are ${share} of the picture`);
    assert.ok(difference(plain.saved, await saved(page), 40) > 0.002, "they are in images too");
    assert.deepEqual(faults, []);
    await page.context().close();
  });
});
