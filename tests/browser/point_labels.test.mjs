/** Labels at points of the surface: placed, named, in the link, and fainter where the surface hides them. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { openPage, saveScreenshot, settled, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();
/** The ball from the front: one label before its middle, one behind. */
const LINK = "#v=1&volume=bumpy&iso=3&camera=25,120,22,25,23,22&measure=l,25,35.5,22,Near%252C%20here;l,25,11.5,22,Far";

test("labels stand at their points, and are fainter behind the surface", { timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/${LINK}`);
  await settled(page);
  const texts = page.locator(".scene-labels span");
  await page.waitForFunction(() => document.querySelectorAll(".scene-labels span.behind").length === 1);
  assert.deepEqual(await texts.allInnerTexts(), ["Near, here", "Far"]);
  assert.deepEqual(await page.locator(".scene-labels span.behind").allInnerTexts(), ["Far"]);
  await page.getByRole("button", { name: "Measure", exact: true }).and(page.locator(".card-head")).click();
  await page.getByRole("button", { name: "Label", exact: true }).click();
  await page.getByRole("button", { name: "Use the centre" }).click();
  const third = page.getByRole("textbox", { name: "Text of label 3" });
  await third.fill("A bump; round");
  await third.press("Enter");
  await page.waitForFunction(() => [...document.querySelectorAll(".scene-labels span")].some(({ textContent }) => textContent === "A bump; round"));
  await page.waitForFunction(() => window.location.hash.includes("A%2520bump%253B%2520round"));
  assert.deepEqual(await violations(page), []);
  await saveScreenshot(page, "point-labels");
  assert.deepEqual(faults, []);
  await page.context().close();
});
