/** The volume that the server brings along opens with a part that matters; links to it are as they were. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { openPage, saveScreenshot, settled, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(() => ({ paths: [], remove: () => undefined }), { demo: true });

test("the demo shows at once what importance is for", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, at.server.url);
  const { triangles, edit, generation } = await settled(page);
  assert.ok(triangles > 15_000 && triangles <= 20_000, `${triangles} triangles`);
  assert.equal(edit.interest.length, 1);
  await page.waitForFunction(() => window.location.hash.includes("color=importance"));
  assert.deepEqual(await violations(page), []);
  await saveScreenshot(page, "demo");
  const compare = page.getByRole("button", { name: "Same budget without importance" });
  await compare.click();
  await page.getByText(/^with importance · /).waitFor();
  const without = await settled(page, (now, before) => now.generation > before, generation);
  assert.ok(Math.abs(without.triangles - triangles) < 1500, `${without.triangles} triangles without, ${triangles} with importance`);
  await compare.click();
  await settled(page, (now, before) => now.generation > before, without.generation);
  await page.getByText(/^with importance · /).waitFor({ state: "detached" });
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("a link to the demo shows what it names alone", { timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/#v=1&volume=mni152&iso=140`);
  const { edit, triangles } = await settled(page);
  assert.deepEqual(edit.interest, []);
  assert.ok(triangles > 20_000, `${triangles} triangles`);
  assert.equal(await page.getByRole("button", { name: "Same budget without importance" }).count(), 0);
  assert.deepEqual(faults, []);
  await page.context().close();
});
