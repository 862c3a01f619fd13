/** A server that asks for a token: the address that it prints lets a browser in, once and for good. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { BINARY, makeVolume, openPage, saveScreenshot, settled, startBrowser, startServer, status, TIMEOUT_MS } from "./harness.mjs";

test("the printed address lets a browser in, and no address has the token after that", { timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const server = await startServer([volume.path], { options: [] });
  const browser = await startBrowser();
  try {
    assert.match(server.secret, /^\/#token=isop_[0-9a-f]{12}_[\w-]{43}$/);
    const context = await browser.newContext();
    // openPage makes pages of a browser; a context makes pages too.
    const { page, faults } = await openPage(context, server.url + server.secret);
    await settled(page);
    await page.waitForFunction(() => window.location.hash.startsWith("#v=1&volume=bumpy"));
    assert.ok(!page.url().includes("token"), page.url());
    // This token is for everything, and so is the page.
    assert.deepEqual([await page.locator(".lacking").count(), await page.locator("fieldset.needs:disabled").count()], [0, 0]);
    assert.equal(await page.getByRole("button", { name: "Your volumes: upload files" }).count(), 1);
    const cookies = await context.cookies();
    assert.deepEqual(
      cookies.map(({ name, httpOnly, sameSite, path }) => ({ name, httpOnly, sameSite, path })),
      [{ name: `isopeel-${server.port}`, httpOnly: true, sameSite: "Lax", path: "/" }],
    );
    assert.equal(await page.evaluate(() => document.cookie), "", "scripts do not see it");
    // What is copied lets nobody else in, but opens here.
    const link = page.url();
    const again = await openPage(context, link);
    await settled(again.page);
    assert.deepEqual([...faults, ...again.faults], []);
    const stranger = await openPage(browser, link);
    await stranger.page.getByText("the server asks for a token").first().waitFor();
    await saveScreenshot(stranger.page, "no-token");
    // The address in a page that is open already.
    await stranger.page.evaluate((hash) => (window.location.hash = hash), server.secret.slice(1));
    await settled(stranger.page);
    assert.ok(!stranger.page.url().includes("token"), stranger.page.url());
  } finally {
    await browser.close();
    await server.stop();
    volume.remove();
  }
});

/** What changes nothing is off, and says why. */
async function offersOnlyLooking(page, messages) {
  const why = page.getByText("You may only look: to change this takes a token for edit");
  await why.first().waitFor();
  const off = page.locator("fieldset.needs");
  assert.ok((await off.count()) >= 3, "surface, detail, importance");
  assert.equal(await off.count(), await page.locator("fieldset.needs:disabled[inert]").count());
  for (const name of ["Your volumes: upload files", "Add a surface", "Compute a field…"]) assert.equal(await page.getByRole("button", { name }).count(), 0, name);
  assert.deepEqual(await violations(page), []);
  await saveScreenshot(page, "only-looks");
  // Whatever of it is pressed or dragged.
  await page.evaluate(() => document.querySelectorAll("fieldset.needs :is(button, input)").forEach((control) => control.click()));
  const slider = await page.locator("fieldset.needs svg").first().boundingBox();
  await page.mouse.click(slider.x + slider.width / 4, slider.y + slider.height / 2);
  await page.keyboard.press("Tab");
  await page.keyboard.press("ArrowRight");
  await page.getByRole("button", { name: "Share and export" }).click();
  await page.getByText("To download meshes takes a token for export").waitFor();
  assert.equal(await page.getByRole("menuitem", { name: "GLB, with colours, in metres" }).getAttribute("aria-disabled"), "true");
  await page.keyboard.press("Escape");
  await new Promise((done) => setTimeout(done, 300));
  const asked = messages.filter(({ type }) => ["edit", "remove"].includes(type));
  assert.deepEqual(asked.filter(({ type, surface, ...values }) => type !== "edit" || Object.keys(values).length > 0), []);
  assert.ok(!messages.some(({ code }) => code === "forbidden"), "nothing was refused");
}

test("whoever may only look sees what a volume opens with, and reads why nothing changes", { timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const state = mkdtempSync(join(tmpdir(), "isopeel-browser-state-"));
  const create = ["token", "create", "--state-folder", state, "--user", "ann", "--role", "view"];
  const token = execFileSync(BINARY, create, { encoding: "utf8", stdio: ["ignore", "pipe", "ignore"] }).trim();
  const server = await startServer([volume.path], { options: ["--state-folder", state] });
  const browser = await startBrowser();
  try {
    const context = await browser.newContext();
    const { page, faults, messages } = await openPage(context, `${server.url}/#token=${token}`);
    // The cut for the camera, measured: nothing follows it.
    const { triangles } = await settled(page, ({ statistics, triangles }) => {
      const { pixels, error } = statistics ?? {};
      return pixels != null && error != null && triangles === statistics.triangles;
    });
    const cookies = await context.cookies();
    assert.ok(!JSON.stringify(cookies).includes(token), "the cookie is not the token");
    await offersOnlyLooking(page, messages);
    // A link has values of somebody else's.
    await page.evaluate(() => (window.location.hash = "#v=1&volume=bumpy&iso=3"));
    await page.getByText("this token is for view, expected one for edit").first().waitFor();
    assert.equal((await status(page)).triangles, triangles, "what was shown is shown still");
    assert.deepEqual(faults, []);
    // The same as the first that is opened.
    const link = await openPage(context, `${server.url}/#v=1&volume=bumpy&iso=3`);
    await link.page.getByText("this token is for view, expected one for edit").first().waitFor();
    await link.page.waitForFunction((expected) => window.isopeel.status.triangles === expected, triangles);
  } finally {
    await browser.close();
    await server.stop();
    volume.remove();
    rmSync(state, { recursive: true });
  }
});
