/** Several isosurfaces at once: what is seen of them, what a link keeps, and what is left when one is removed. */

import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { violations } from "./accessibility.mjs";
import { difference, MORE, openPage, picture, rested, saveScreenshot, settled, skipTour, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

/** All of so many surfaces are there, and in the last frame. */
const surfaces = (page, count) => settled(page, (now, count) => now.surfaces.length === count && now.surfaces.every(({ triangles }) => triangles > 0), count);

async function setNumber(page, name, value) {
  const field = page.getByRole("textbox", { name, exact: true });
  await field.fill(String(value));
  await field.press("Enter");
}

/** Two balls in each other: the first is the inner one, and the second lets it be seen. */
async function nest(page) {
  await settled(page);
  await setNumber(page, "Isovalue", 7);
  await page.getByRole("button", { name: "Add a surface" }).click();
  await setNumber(page, "Isovalue of surface 2", 0);
  return surfaces(page, 2);
}

/** The colour at the middle of the picture. */
function middle({ width, height, data }) {
  const at = 4 * (Math.floor(height / 2) * width + Math.floor(width / 2));
  return [...data.subarray(at, at + 3)];
}

const hashOf = (page, part) => page.waitForFunction((part) => location.hash.includes(part), part);

describe("several surfaces", { ...MORE, timeout: 6 * TIMEOUT_MS }, () => {
  test("two in each other come, one translucent, survive a reload by link, and one that is removed is freed", async () => {
    const { page, faults, messages } = await openPage(at.browser, at.server.url);
    const opened = await settled(page);
    const two = await nest(page);
    assert.deepEqual(two.surfaces.map(({ edit, style }) => [edit.iso, style.opacity]), [[7, 1], [0, 0.35]]);
    assert.ok(two.surfaces[0].triangles < two.surfaces[1].triangles, "the inner ball is the smaller one");
    assert.equal(two.triangles, two.surfaces[0].triangles + two.surfaces[1].triangles);
    await page.locator(".sentence").getByText("2 surfaces").waitFor();
    await page.getByRole("button", { name: "Fit the surface into the picture" }).click();

    // Ivory within orange: the orange ball alone is less blue, and the ivory one alone is bluer.
    const blueness = async () => {
      const [red, , blue] = middle(await picture(page));
      return blue / red;
    };
    const nested = await blueness();
    await saveScreenshot(page, "surfaces");
    await setNumber(page, "Opacity of surface 2, percent", 100);
    const solid = await blueness();
    await page.getByRole("button", { name: "Hide surface 2" }).click();
    const inner = await blueness();
    assert.ok(solid < 0.95 * nested && nested < 0.95 * inner, `${solid}, ${nested}, ${inner}`);
    for (let step = 0; step < 2; step += 1) await page.getByRole("button", { name: "Undo" }).click();

    // Cards are about the selected one.
    const before = messages.length;
    await page.getByRole("button", { name: "Select surface 1" }).click();
    await page.getByRole("button", { name: "Select surface 2" }).click();
    await page.getByRole("radiogroup", { name: "Importance by" }).getByText("Shape").click();
    await surfaces(page, 2);
    const edits = messages.slice(before).filter(({ type, generation }) => type === "edit" && generation === undefined);
    assert.deepEqual(edits.map(({ surface, feature }) => [surface, feature]), [[1, "none"]]);

    await hashOf(page, "s2.iso=0");
    await hashOf(page, "s2.opacity=0.35");
    await page.waitForTimeout(1000);
    const made = await rested(page);
    const [link, seen] = [page.url(), await picture(page)];
    const other = await openPage(at.browser, link);
    await surfaces(other.page, 2);
    const again = await rested(other.page);
    // The range of a feature that is none is not kept.
    const values = ({ edit: { featureRange: _, ...edit }, style }) => JSON.parse(JSON.stringify({ edit, style }));
    assert.deepEqual(again.surfaces.map(values), made.surfaces.map(values));
    assert.deepEqual(again.surfaces.map(({ triangles }) => triangles), made.surfaces.map(({ triangles }) => triangles));
    assert.equal(again.selected, 1);
    assert.ok(difference(seen, await picture(other.page)) < 0.01, "the same picture");
    await other.page.context().close();

    const { geometries, regions } = await status(page);
    await page.getByRole("button", { name: "Remove surface 2" }).click();
    const one = await settled(page, (now) => now.surfaces.length === 1 && now.allTriangles[1] === 0);
    assert.ok(messages.some(({ type, surface }) => type === "removed" && surface === 1));
    assert.equal(one.triangles, one.surfaces[0].triangles);
    assert.equal(geometries - one.geometries, regions - one.regions, "its meshes are not in the GPU's memory any more");
    assert.ok(one.regions < regions && one.geometries <= opened.geometries + 2, JSON.stringify([opened.geometries, geometries, one.geometries]));
    assert.equal(await page.evaluate(() => document.activeElement.textContent.trim()), "Add a surface");
    await page.keyboard.press("Control+z");
    await surfaces(page, 2);
    const back = await rested(page);
    assert.deepEqual(back.surfaces.map(({ triangles }) => triangles), made.surfaces.map(({ triangles }) => triangles));
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("a server that knows one alone shows the first of a link, and offers no more", async () => {
    const page = await at.browser.newPage({ viewport: { width: 1100, height: 760 } });
    page.setDefaultTimeout(TIMEOUT_MS);
    await skipTour(page);
    await page.routeWebSocket(/\/api\/v1\/stream$/, (socket) => {
      socket.connectToServer().onMessage((data) => socket.send(typeof data === "string" ? data.replace(/"surfaces":\d/, '"surfaces":1') : data));
    });
    await page.goto(`${at.server.url}/#volume=bumpy&iso=5&s2.iso=0`);
    await page.getByText("This link has more surfaces than this server shows at once, which is 1").waitFor();
    await page.waitForFunction(() => window.isopeel.status.settled);
    const now = await status(page);
    assert.deepEqual(now.surfaces.map(({ edit }) => edit.iso), [5]);
    assert.equal(await page.getByRole("button", { name: "Add a surface" }).count(), 0);
    await page.context().close();
  });

  test("handles, keys and four of them, for everyone", async () => {
    const { page, faults } = await openPage(at.browser, at.server.url, { viewport: { width: 1440, height: 1000 } });
    await nest(page);
    // A handle that is dragged is that of the selected surface from then on.
    const box = await page.getByRole("slider", { name: "Isovalue of surface 1" }).boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + 20);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2 - 25, box.y + 20, { steps: 5 });
    await page.mouse.up();
    const dragged = await settled(page, (now) => now.selected === 0 && now.edit.iso < 6);
    assert.equal(dragged.surfaces[1].edit.iso, 0);
    await page.keyboard.press("Control+z");
    await settled(page, (now) => now.surfaces[0].edit.iso === 7);
    const handle = page.getByRole("slider", { name: "Isovalue of surface 2" });
    await handle.press("ArrowRight");
    const keyed = await settled(page, (now) => now.selected === 1 && now.edit.iso > 0);
    assert.equal(await handle.getAttribute("aria-valuetext"), String(Number(keyed.edit.iso.toPrecision(5))));
    for (const count of [3, 4]) {
      await page.getByRole("button", { name: "Add a surface" }).click();
      await settled(page, (now, count) => now.surfaces.length === count, count);
    }
    await page.getByText("Maximum of 4 surfaces").waitFor();
    assert.equal(await page.getByRole("button", { name: "Add a surface" }).count(), 0);
    for (const theme of ["dark", "light"]) {
      await page.emulateMedia({ colorScheme: theme });
      await page.locator(`html[data-theme=${theme}]`).waitFor();
      assert.deepEqual(await violations(page), [], theme);
      await saveScreenshot(page, `surfaces-four-${theme}`);
    }
    const small = await page.locator(".surfaces button, .surfaces input:not(.choice-input), .foot button").evaluateAll((all) => all.map((e) => e.getBoundingClientRect()).filter(({ width, height }) => width < 24 || height < 24).length);
    assert.equal(small, 0);
    // On the narrowest page nothing reaches over its edge.
    await page.setViewportSize({ width: 320, height: 640 });
    await page.getByRole("button", { name: "Surface", exact: true }).click();
    const over = await page.locator(".surfaces *, .foot *").evaluateAll((all) => all.filter((e) => e.getBoundingClientRect().right > 320).map((e) => e.className));
    assert.deepEqual(over, []);
    assert.deepEqual(faults, []);
    await page.context().close();
  });
});
