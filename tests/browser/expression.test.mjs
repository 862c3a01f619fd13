/** An expression over fields as the field that is shown, and as what matters: typed, told what is wrong, kept by a link. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeVolume, MORE, openPage, rested, saveScreenshot, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(makeVolume);

test("expressions are typed as field and as feature", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#volume=bumpy&error=0`, { colorScheme: "light" });
  const plain = await rested(page);
  const { field, iso } = plain.edit;
  const card = page.getByRole("region", { name: "Surface", exact: true });
  await card.getByRole("button", { name: "Compute a field…" }).click();
  const text = card.getByRole("textbox", { name: "Expression of the field" });
  // What is wrong is said where it is, before anything is used.
  await text.fill("2 * heigth");
  await card.getByText(/^no field "heigth", expected one of/).waitFor();
  assert.equal(await card.locator("pre.fault").textContent(), "2 * heigth\n    ▲");
  assert.ok(await card.getByRole("button", { name: "Use" }).isDisabled());
  await saveScreenshot(page, "expression-fault");
  // Fields and functions are put in at the cursor.
  await text.fill("");
  await card.getByRole("group", { name: "Functions" }).getByRole("button", { name: "abs" }).click();
  await card.getByRole("group", { name: "Fields" }).getByRole("button", { name: "height" }).click();
  assert.equal(await text.inputValue(), "abs(height)");
  await text.fill(`2 * ${field}`);
  await card.getByText(/^Values from /).waitFor();
  await text.press("Enter");
  await page.waitForFunction((name) => window.isopeel.status.edit.field === name, `2 * ${field}`);
  const twice = await rested(page);
  assert.ok(Math.abs(twice.edit.iso - 2 * iso) <= 1e-3 * Math.abs(iso) + 1e-6, `opens at ${twice.edit.iso}, the field at ${iso}`);
  assert.equal(twice.triangles, plain.triangles, "the same surface");
  assert.equal(await card.getByRole("slider").first().isVisible(), true, "with a histogram");
  await saveScreenshot(page, "expression");

  const matters = page.getByRole("region", { name: "Importance", exact: true });
  await matters.getByText("Field", { exact: true }).click();
  await matters.getByRole("button", { name: "Expression…" }).click();
  const feature = matters.getByRole("textbox", { name: "Expression of the importance field" });
  await feature.fill("height ^ 2");
  await matters.getByText(/^Values from /).waitFor();
  await feature.press("Enter");
  await page.waitForFunction(() => window.isopeel.status.edit.feature === "height ^ 2");
  const both = await rested(page);
  assert.ok(both.triangles > 0);

  const again = await openPage(at.browser, page.url());
  const linked = await rested(again.page);
  assert.deepEqual([linked.edit.field, linked.edit.feature, linked.triangles], [`2 * ${field}`, "height ^ 2", both.triangles], "the link brings them");
  await again.page.getByRole("region", { name: "Surface", exact: true }).getByRole("slider").first().waitFor();
  await again.page.close();
  // The browser says itself that a question was refused.
  assert.deepEqual([...faults, ...again.faults].filter((fault) => !String(fault).includes("422")), []);
});
