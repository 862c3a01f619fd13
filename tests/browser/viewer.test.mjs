/** The viewer in chromium against the server and its device, with a small volume. */

import assert from "node:assert/strict";
import { afterEach, beforeEach, describe, test } from "node:test";
import {
  cameraAtRest,
  decideBy,
  difference,
  dragSlider,
  frameAfter,
  MORE,
  openPage,
  picture,
  rested,
  TIMEOUT_MS,
  saveScreenshot,
  settled,
  status,
} from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();
let page;
let faults;
let messages;

/** The address with which each test begins. */
let opened;

/** Has the page follow the address with which it was opened: a link sets all values and the look. */
async function reset() {
  // The page writes the last change of the test before into its address 400 ms after it.
  await page.waitForTimeout(450);
  await page.evaluate(async (hash) => {
    if (window.location.hash === hash) return;
    const followed = new Promise((done) => window.addEventListener("hashchange", done, { once: true }));
    window.location.hash = hash;
    await followed;
    await new Promise(requestAnimationFrame);
  }, opened);
  await rested(page);
  await cameraAtRest(page);
}

// To open a page takes two seconds of a processor, so tests share one until one of them fails.
beforeEach(async () => {
  if (page !== undefined) return reset();
  ({ page, faults, messages } = await openPage(at.browser, at.server.url));
  await rested(page);
  await page.waitForURL(/iso=/);
  opened = await page.evaluate(() => window.location.hash);
});

afterEach(async (context) => {
  await saveScreenshot(page, context.name.replaceAll(/\W+/g, "-"));
  assert.deepEqual(faults, [], "errors on the console");
  if (context.passed) return;
  await page.close();
  page = undefined;
});

describe("viewer", { timeout: 4 * TIMEOUT_MS }, () => {
  test("the surface appears, in colour", async () => {
    const surface = await picture(page);
    const now = await status(page);
    assert.ok(now.triangles > 500, `${now.triangles} triangles`);
    assert.equal(now.triangles, now.statistics.triangles);
    assert.deepEqual(now.messages, []);

    await page.locator(".viewport canvas").evaluate((canvas) => (canvas.style.opacity = "0"));
    const background = await picture(page);
    await page.locator(".viewport canvas").evaluate((canvas) => (canvas.style.opacity = ""));
    // A fitted ball fills a third of the canvas.
    const share = difference(surface, background);
    assert.ok(share > 0.2, `${(100 * share).toFixed(1)} % of the pixels differ from the background`);
    const colours = new Set();
    for (let i = 0; i < surface.data.length; i += 4) {
      const [r, g, b] = surface.data.subarray(i, i + 3);
      if (Math.max(r, g, b) - Math.min(r, g, b) > 20) colours.add((r >> 3) * 1024 + (g >> 3) * 32 + (b >> 3));
    }
    assert.ok(colours.size > 50, `${colours.size} colours that are no grey`);
  });

  test("a region of interest has the colour of its importance, and is compared with as many triangles without", async () => {
    const region = "0,0,0,25,47,44,0.9";
    const { volume } = await status(page);
    await page.goto(`${at.server.url}/#v=1&volume=${volume}&triangles=1500&alpha=0&tf=0,0,000000;1,0,000000&color=importance&map=ylor&roi=${region}`);
    await page.reload();
    const before = await rested(page);
    const { data } = await picture(page);
    let [red, pale] = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
      if (data[i] > 2 * data[i + 1] && data[i] > 100) red += 1;
      if (data[i] > 100 && data[i + 1] > 0.85 * data[i] && data[i + 2] < 0.9 * data[i]) pale += 1;
    }
    assert.ok(Math.min(red, pale) > 2000, `${red} red pixels, ${pale} pale ones`);

    const without = page.getByRole("switch", { name: "Same budget without importance" });
    await without.setChecked(true, { force: true });
    const now = await settled(page, ({ generation }, before) => generation > before, before.generation);
    const asked = () => messages.filter(({ type }) => type === "edit").at(-1).interest.length;
    assert.equal(asked(), 0);
    assert.ok(now.triangles <= before.triangles && now.triangles > 0.9 * before.triangles, `${now.triangles} and ${before.triangles} triangles`);
    await without.setChecked(false, { force: true });
    const after = await settled(page, ({ generation }, before) => generation > before, now.generation);
    assert.deepEqual([asked(), after.triangles], [1, before.triangles]);
  });

  test("a reload keeps an edit of the last moment", async () => {
    await page.getByRole("switch", { name: "Wireframe" }).setChecked(true, { force: true });
    await page.evaluate(() => location.reload());
    await page.waitForURL(/wire=1/);
    await rested(page);
    assert.ok(await page.getByRole("switch", { name: "Wireframe" }).isChecked());
  });

  test("an address that is entered while the page is busy is followed, whatever was edited just before", async () => {
    const wireframe = page.getByRole("switch", { name: "Wireframe" });
    const flat = page.getByRole("switch", { name: "Flat triangles" });
    await page.waitForURL(/iso=/);
    // Which of the two events comes first is a matter of chance.
    for (let i = 0; i < 4; i += 1) {
      const entered = await page.evaluate(() => `${location.href.replace("&flat=1", "")}&flat=1`);
      await wireframe.evaluate((input) => {
        input.click();
        setTimeout(() => {
          for (const began = performance.now(); performance.now() - began < 500; );
        });
      });
      await page.goto(entered);
      await flat.and(page.locator(":checked")).waitFor({ state: "attached", timeout: 10_000 });
      await flat.evaluate((input) => input.click());
      await page.waitForURL((url) => !url.hash.includes("flat=1"));
    }
  });

  test("dragging β changes the triangle count, its low end is the full surface", async () => {
    await decideBy(page, "β (paper)");
    await dragSlider(page, "β", 0);
    const full = await settled(page, (now) => now.edit.beta < 0 && now.statistics.triangles === now.triangles);
    // Every active cell is a leaf. The number of triangles depends on the mesher; fullTriangles counts those of marching cubes.
    assert.deepEqual(full.statistics.leaves, [full.statistics.activeCells, 0, 0, 0, 0, 0]);
    await dragSlider(page, "β", 0.95);
    const coarse = await settled(page, (now, full) => now.edit.beta > 0.3 && now.triangles < full, full.triangles);
    assert.ok(coarse.triangles < 0.5 * full.triangles, `${coarse.triangles} of ${full.triangles} triangles`);
    assert.ok(coarse.generation > full.generation);
  });

  test("a budget of triangles is kept, and an error is in force where it decides", async () => {
    await decideBy(page, "Triangles");
    const field = page.getByRole("textbox", { name: "Triangles" });
    await field.fill("1500");
    await field.press("Enter");
    const kept = await settled(page, (now) => now.edit.triangles === 1500 && now.statistics.triangles === now.triangles && now.triangles <= 1500);
    assert.ok(kept.triangles > 1200, `${kept.triangles} triangles`);
    await rested(page);

    await decideBy(page, "Error");
    // For a camera nothing below a quarter of a pixel is refined.
    const finer = page.getByRole("switch", { name: "Finer where you look" });
    await finer.press("Space");
    const error = page.getByRole("textbox", { name: "Error" });
    await error.fill("0.02vx");
    await error.press("Enter");
    const fine = await settled(page, (now) => now.edit.error === "0.02vx" && now.statistics.tolerance < 0.03);
    assert.equal(fine.edit.triangles, undefined);
    assert.ok(fine.triangles > kept.triangles, `${fine.triangles} triangles`);
    assert.equal(await page.getByText("the budget is too small").isVisible(), false);
    await finer.press("Space");
    await settled(page, (now) => now.edit.detail === "view");
  });

  test("a colour edit changes pixels and sends nothing", async () => {
    const { framesDrawn } = await status(page);
    await page.getByRole("radiogroup", { name: "Colour by" }).getByText("Transfer").click();
    await frameAfter(page, framesDrawn);
    await cameraAtRest(page);
    const before = await status(page);
    const old = await picture(page);
    const point = page.locator(".handle").first();
    const color = page.getByLabel("Colour of the point");
    await point.click();
    await color.fill("#ff00ff");
    await page.locator(".handle").last().click();
    await color.fill("#00ff40");
    await frameAfter(page, before.framesDrawn);
    await cameraAtRest(page);
    const recoloured = await picture(page);
    const share = difference(old, recoloured, 40);
    assert.ok(share > 0.05, `${(100 * share).toFixed(1)} % of the pixels changed`);
    const now = await status(page);
    assert.equal(now.framesSent, before.framesSent);
    assert.equal(now.generation, before.generation);
    assert.equal(now.bytesReceived, before.bytesReceived);
    assert.equal(now.edit.transferFunction.points.at(-1).color, "#00ff40");

    // Each colour is a step of its own in the history; undoing it sends nothing either.
    await page.getByRole("button", { name: "Undo" }).click();
    await page.getByRole("button", { name: "Undo" }).click();
    await frameAfter(page, now.framesDrawn);
    await cameraAtRest(page);
    assert.ok(difference(old, await picture(page), 12) < 0.001, "undone to the picture before");
    assert.equal((await status(page)).framesSent, before.framesSent);
  });

  test("dragging a point's importance sends edits, and the cut follows", MORE, async () => {
    await decideBy(page, "Error");
    const before = await rested(page);
    // The editor comes back into sight.
    await page.locator("details.expert").evaluate((details) => (details.open = false));
    const box = await page.locator(".handle").last().boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x, y + 60, { steps: 6 });
    await page.mouse.move(x, y + 200, { steps: 6 });
    await page.mouse.up();
    const now = await settled(
      page,
      (now, before) => now.edit.transferFunction.points.at(-1).importance === 0 && now.triangles < before,
      before.triangles,
    );
    assert.ok(now.framesSent > before.framesSent);
    assert.ok(now.generation > before.generation);
  });

  test("many edits in a row end at the last one", async () => {
    // Smoothness decides most, so that β in a small range changes the surface.
    const alpha = page.getByRole("textbox", { name: "Balance α" });
    await alpha.fill("0.2");
    await alpha.press("Enter");
    await settled(page, (now) => now.edit.alpha === 0.2);
    // What the last edit gives when it is sent alone.
    await decideBy(page, "β (paper)");
    const field = page.getByRole("textbox", { name: "β" });
    await field.fill("0.15");
    await field.press("Enter");
    const alone = await settled(page, (now) => now.statistics.beta === 0.15 && now.statistics.triangles === now.triangles);
    await field.fill("0.001");
    await field.press("Enter");
    const other = await settled(page, (now) => now.statistics.beta === 0.001 && now.statistics.triangles === now.triangles);
    assert.notEqual(other.triangles, alone.triangles);

    await page.evaluate(async () => {
      const slider = [...document.querySelectorAll("input[type=range]")].find(
        (s) => s.closest(".control").querySelector("label").textContent === "β",
      );
      for (let i = 0; i < 150; i += 1) {
        slider.value = String(100 + ((i * 379) % 900));
        slider.dispatchEvent(new Event("input"));
        await new Promise((turn) => setTimeout(turn, 4));
      }
    });
    await field.fill("0.15");
    await field.press("Enter");
    const last = await settled(
      page,
      (now, alone) => now.statistics.beta === 0.15 && now.triangles === alone,
      alone.triangles,
    );
    assert.equal(last.statistics.triangles, alone.triangles);
    assert.deepEqual(last.messages, []);
    // The page sends at most 20 edits a second.
    const sent = last.framesSent - other.framesSent;
    assert.ok(sent < 150, `${sent} frames for 151 edits`);
  });

  test("half-typed numbers send nothing", MORE, async () => {
    const before = await status(page);
    const sent = messages.length;
    const field = page.getByRole("textbox", { name: "Isovalue" });
    await field.focus();
    for (const key of ["-", ".", "1", "e"]) await field.press(key);
    assert.equal((await status(page)).framesSent, before.framesSent);
    await field.press("Escape");
    assert.equal(Number(await field.inputValue()), Number(before.edit.iso.toPrecision(5)));
    await field.fill("4");
    await field.press("Enter");
    const now = await settled(page, (now) => now.edit.iso === 4);
    // The viewer may also acknowledge the first prefix.
    assert.equal(messages.slice(sent).filter(({ type }) => type === "edit").length, 1);
    assert.notEqual(now.triangles, before.triangles);
  });

  test("colour modes, peeling and edges send nothing", async () => {
    const before = await status(page);
    let [last, drawn] = [await picture(page), before.framesDrawn];
    const expectChange = async (act, minShare) => {
      await act();
      await frameAfter(page, drawn);
      // A busy machine draws frames of lower quality first.
      await cameraAtRest(page);
      const next = await picture(page);
      const share = difference(last, next);
      assert.ok(share > minShare, `${(100 * share).toFixed(2)} % of the pixels changed`);
      [last, drawn] = [next, (await status(page)).framesDrawn];
    };
    await expectChange(() => page.getByText("Level", { exact: true }).click(), 0.1);
    await saveScreenshot(page, "view-by-level");
    const finest = before.levelTriangles.findIndex((n) => n > 0);
    const peel = page.getByRole("slider", { name: "Peel", exact: true });
    await expectChange(async () => {
      for (let level = 0; level <= finest; level++) await peel.press("ArrowRight");
    }, 0.01);
    await expectChange(() => peel.press("Home"), 0.01);
    await expectChange(() => page.getByText("Wireframe").click(), 0.01);
    await expectChange(() => page.getByRole("radiogroup", { name: "Colour by" }).getByText("Importance", { exact: true }).click(), 0.1);
    const now = await status(page);
    assert.equal(now.framesSent, before.framesSent);
    assert.equal(now.triangles, before.triangles);
  });

  test("another feature asks the server, and the camera stays", MORE, async () => {
    const before = await status(page);
    await page.getByRole("radiogroup", { name: "Importance by" }).getByText("Field", { exact: true }).click();
    await page.getByLabel("Importance field").selectOption("height");
    const now = await settled(page, (now, before) => now.edit.feature === "height" && now.generation > before, before.generation);
    assert.deepEqual(now.edit.featureRange, [0, 43]);
    assert.equal(now.camera.fitted, before.camera.fitted);
    const apart = Math.hypot(...now.camera.position.map((p, axis) => p - before.camera.position[axis]));
    assert.ok(apart < 1e-6, `the camera moved by ${apart} world units`);
    assert.deepEqual(now.messages, []);
  });

  test("a view without a surface is explained", MORE, async () => {
    const field = page.getByRole("textbox", { name: "Isovalue" });
    await field.fill("1000");
    await field.press("Enter");
    await settled(page, (now) => now.triangles === 0);
    await page.getByText("No surface at isovalue 1000").waitFor();
  });

  test("the light theme is light, and nothing is drawn while nothing changes", MORE, async () => {
    const dark = await picture(page);
    await page.getByRole("button", { name: "Switch between dark and light" }).click();
    await page.locator("html[data-theme=light]").waitFor();
    const light = await picture(page);
    const [x, y] = [4, light.height - 60];
    const brightness = ({ data, width }) => data[4 * (y * width + x)];
    assert.ok(brightness(light) > brightness(dark) + 100);
    const { framesDrawn } = await status(page);
    // In ten animation frames a viewer that renders all the time would have rendered.
    await page.evaluate(async () => {
      for (let i = 0; i < 10; i += 1) await new Promise(requestAnimationFrame);
    });
    assert.ok((await status(page)).framesDrawn <= framesDrawn + 1);
  });
});
