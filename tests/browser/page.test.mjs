/** The page around the picture: links, history, files, the tour, and what everybody needs. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { describe, test } from "node:test";
import { PNG } from "pngjs";
import { violations } from "./accessibility.mjs";
import { difference, dragSlider, MORE, openPage, picture, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

const SIZES = { desktop: [1440, 900], window: [1120, 700], tablet: [1024, 768], phone: [390, 844], narrow: [320, 640] };
const openAt = (size, colorScheme, options = {}) => {
  const [width, height] = SIZES[size];
  return openPage(at.browser, at.server.url, { viewport: { width, height }, colorScheme, ...options });
};

const FOLDED = ["Look", "View", "Clip", "Slices", "Measure", "Compare", "Export", "Numbers"];

/** Shows everything that is folded, so that it is looked at too. */
async function unfold(page) {
  for (const name of FOLDED) {
    const head = page.getByRole("button", { name, exact: true }).and(page.locator(".card-head"));
    if ((await head.getAttribute("aria-expanded")) === "false") await head.click();
  }
  await page.locator("details.expert").evaluate((details) => (details.open = true));
  await page.getByRole("radiogroup", { name: "Limit by" }).waitFor();
}

/** Looks at the page, then at what opens over it. */
async function expectNoViolations(page, size, theme) {
  if (size === "phone") {
    for (const card of ["Surface", "Detail", "Importance", ...FOLDED]) {
      await page.getByRole("button", { name: card, exact: true }).click();
      assert.deepEqual(await violations(page), [], `${theme}, ${card}`);
    }
    return;
  }
  assert.deepEqual(await violations(page), [], theme);
  await page.getByRole("button", { name: "Share and export" }).click();
  await page.getByRole("menuitem", { name: "Copy link" }).waitFor();
  assert.deepEqual(await violations(page), [], `${theme}, menu`);
  await page.keyboard.press("Escape");
  await page.getByRole("button", { name: "Help" }).click();
  await page.getByRole("dialog").waitFor();
  assert.deepEqual(await violations(page), [], `${theme}, help`);
  await page.keyboard.press("Escape");
}

describe("for everyone", { timeout: 6 * TIMEOUT_MS }, () => {
  for (const size of ["desktop", "tablet", "phone"]) {
    test(`WCAG 2.2 AA holds, dark and light: ${size}`, size === "desktop" ? {} : MORE, async () => {
      const { page, faults } = await openAt(size, "dark");
      await settled(page);
      if (size !== "phone") await unfold(page);
      for (const theme of ["dark", "light"]) {
        await page.emulateMedia({ colorScheme: theme });
        await page.locator(`html[data-theme=${theme}]`).waitFor();
        await expectNoViolations(page, size, theme);
        await saveScreenshot(page, `page-${size}-${theme}`);
      }
      assert.deepEqual(faults, []);
      await page.context().close();
    });
  }

  test("320 pixels are wide enough: nothing but the row of cards to scroll sideways", MORE, async () => {
    const { page } = await openAt("narrow", "dark");
    await settled(page);
    for (const card of ["Surface", "Detail", "Importance", "Look"]) {
      await page.getByRole("button", { name: card, exact: true }).click();
      const wide = await page.evaluate(() => {
        const over = [...document.querySelectorAll(".page *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1 && !e.closest("svg, .sentence, .unseen, select, .card-icons"));
        return { page: document.documentElement.scrollWidth, over: over.map((e) => e.className || e.tagName) };
      });
      assert.deepEqual(wide, { page: 320, over: [] }, card);
    }
    await page.context().close();
  });

  test("the whole editor is in sight at 1024 × 768", MORE, async () => {
    const { page } = await openAt("tablet", "dark");
    await settled(page);
    for (const part of [page.locator(".histogram-slider"), page.getByRole("slider", { name: "Triangles" }), page.locator(".transfer-plot"), page.locator(".point-row")]) {
      const box = await part.boundingBox();
      assert.ok(box !== null && box.y >= 0 && box.y + box.height <= 768, `${part} ends at ${box.y + box.height}`);
    }
    await page.context().close();
  });

  test("targets have 24 pixels or more", MORE, async () => {
    const { page } = await openAt("desktop", "dark");
    await settled(page);
    await unfold(page);
    const small = await page.evaluate(() => {
      const targets = [...document.querySelectorAll("button, select, input:not(.choice-input, .toggle-input), .choice-label, .toggle, summary")];
      const visible = targets.map((e) => ({ name: `${e.className} ${e.textContent}`.slice(0, 60), ...e.getBoundingClientRect().toJSON() })).filter(({ width }) => width > 1);
      return visible.filter(({ width, height }) => width < 24 || height < 24).map(({ name, width, height }) => `${name}: ${width} × ${height}`);
    });
    assert.deepEqual(small, []);
    await page.context().close();
  });
});

describe("the page", { timeout: 6 * TIMEOUT_MS }, () => {
  test("a link brings back volume, values, look and camera, in another browser", async () => {
    const { page } = await openAt("window", "dark");
    const before = await settled(page);
    const field = page.getByRole("textbox", { name: "Triangles" });
    await field.fill("900");
    await field.press("Enter");
    await page.locator(".viewport canvas").hover();
    await page.mouse.down();
    await page.mouse.move(500, 300, { steps: 4 });
    await page.mouse.up();
    await page.getByRole("radiogroup", { name: "Colour by" }).getByText("Level").click();
    const made = await rested(page);
    assert.equal(made.edit.triangles, 900);
    await page.waitForFunction(() => location.hash.includes("triangles=900") && location.hash.includes("color=level"));
    await page.waitForTimeout(1000);
    const { position } = (await status(page)).camera;
    const link = page.url();
    await page.context().close();

    const other = await openPage(at.browser, link);
    const now = await rested(other.page);
    assert.deepEqual(now.edit, made.edit);
    assert.equal(now.triangles, made.triangles);
    assert.ok(now.framesSent <= 3, `${now.framesSent} messages: the link's values are in the first edit`);
    const apart = Math.hypot(...now.camera.position.map((p, axis) => p - position[axis]));
    assert.ok(apart < 1e-3 * Math.hypot(...position), `the camera is ${apart} away`);
    assert.equal(await other.page.getByRole("radio", { name: "Level" }).isChecked(), true);
    assert.equal(await other.page.getByRole("button", { name: "Undo" }).getAttribute("aria-disabled"), "true");

    // A changed address is followed, and can be undone.
    await other.page.evaluate((iso) => (location.hash = `#volume=${window.isopeel.status.volume}&iso=${iso}`), 4);
    const followed = await settled(other.page, (now) => now.edit.iso === 4);
    assert.deepEqual(followed.edit.error, before.edit.error);
    await other.page.keyboard.press("Control+z");
    await settled(other.page, (now) => now.edit.triangles === 900);
    await other.page.context().close();
  });

  test("an unknown volume and a broken link are answered with a sentence", MORE, async () => {
    for (const [hash, text] of [["#volume=nowhere", /There is no volume “nowhere” on this server. Shown instead: /], ["#volume=bumpy&iso=high", /“iso” is "high", expected a number/]]) {
      const { page } = await openPage(at.browser, `${at.server.url}/${hash}`);
      await page.getByText(text).waitFor();
      await page.waitForFunction(() => window.isopeel.status.triangles > 0);
      await page.context().close();
    }
  });

  test("undo and redo go through values and look", async () => {
    const { page } = await openAt("window", "dark");
    const { edit } = await settled(page);
    await page.getByRole("slider", { name: "Isovalue" }).press("ArrowRight");
    await page.getByText("Wireframe").click();
    const wire = page.getByRole("switch", { name: "Wireframe" });
    assert.equal(await wire.isChecked(), true);
    await page.keyboard.press("Control+z");
    assert.equal(await wire.isChecked(), false);
    await page.keyboard.press("Control+z");
    await settled(page, (now, iso) => now.edit.iso === iso, edit.iso);
    await page.keyboard.press("Control+Shift+z");
    await settled(page, (now, iso) => now.edit.iso !== iso, edit.iso);
    await page.context().close();
  });

  test("the slider of detail decides whatever limited the surface before, and each drag is one step", async () => {
    const { page } = await openAt("window", "dark");
    const before = await rested(page);
    assert.equal(before.edit.error, "1px");
    await dragSlider(page, "Triangles", 0.5667);
    const coarse = await settled(page, (now) => now.edit.triangles?.share < 0.06 && now.triangles <= 0.06 * now.statistics.fullTriangles);
    assert.equal(coarse.edit.error, undefined);
    assert.ok(coarse.triangles > 0.03 * coarse.statistics.fullTriangles, `${coarse.triangles} triangles`);
    // Of a share that is rounded a key changes the last digit.
    await page.keyboard.press("ArrowRight");
    await settled(page, (now, before) => now.edit.triangles?.share > before, coarse.edit.triangles.share);
    await page.getByRole("button", { name: "Undo" }).click();
    await dragSlider(page, "Triangles", 1);
    const full = await settled(page, (now) => now.edit.triangles?.share === 1);
    const { fullTriangles, pixels, triangles } = full.statistics;
    assert.ok(triangles > 0.9 * fullTriangles || pixels.limitedBy === "pixels", `${triangles} triangles`);
    await page.getByRole("button", { name: "Undo" }).click();
    await page.getByRole("button", { name: "Undo" }).click();
    const undone = await settled(page, (now) => now.edit.error === "1px");
    assert.deepEqual(undone.edit.triangles, before.edit.triangles);
    assert.equal(await page.getByRole("button", { name: "Undo" }).getAttribute("aria-disabled"), "true");
    await page.context().close();
  });

  test("the mesh of what is seen is downloaded", async () => {
    const { page } = await openAt("window", "dark");
    await settled(page);
    // Files are alike everywhere.
    await page.getByRole("switch", { name: "Finer where you look" }).press("Space");
    const field = page.getByRole("textbox", { name: "Triangles" });
    await field.fill("800");
    await field.press("Enter");
    const { statistics } = await rested(page);
    await page.getByRole("button", { name: "Share and export" }).click();
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("menuitem", { name: /STL/ }).click()]);
    assert.match(download.suggestedFilename(), /\.stl$/);
    const file = readFileSync(await download.path());
    // 80 bytes of header, the number of triangles, 50 bytes each.
    assert.equal(file.readUInt32LE(80), statistics.triangles);
    assert.equal(file.length, 84 + 50 * statistics.triangles);
    await page.context().close();
  });

  test("clip, slices, a comparison and an image of them", async () => {
    const { page, faults, messages } = await openAt("window", "dark");
    await rested(page);
    const opened = await picture(page);
    const card = (name) => page.getByRole("button", { name, exact: true }).and(page.locator(".card-head"));
    for (const name of ["Surface", "Importance", "Look"]) await card(name).click();

    await card("Clip").click();
    await page.getByRole("radiogroup", { name: "Plane" }).getByText("⟂ x").click();
    await page.waitForFunction(() => location.hash.includes("plane=-1,0,0"));
    const clipped = await picture(page);
    assert.ok(difference(opened, clipped) > 0.05, "half of the ball is cut away");
    const offset = page.getByRole("textbox", { name: "Where the plane lies" });
    const before = await offset.inputValue();
    await page.getByRole("slider", { name: "Clip plane" }).press("Shift+ArrowRight");
    assert.notEqual(await offset.inputValue(), before, "the handle in the picture moves the number");
    await page.keyboard.press("Control+z");
    assert.equal(await offset.inputValue(), before);

    await card("Slices").click();
    const { framesDrawn } = await status(page);
    const answer = page.waitForResponse(/slices\?/);
    await page.locator(".toggle", { hasText: "Perpendicular to z" }).locator(".toggle-track").click();
    assert.equal((await answer).status(), 200);
    await page.waitForFunction((before) => window.isopeel.status.framesDrawn > before, framesDrawn);
    assert.ok(difference(clipped, await picture(page)) > 0.03, "the slice is seen");

    const sent = messages.length;
    await card("Compare").click();
    await page.getByRole("button", { name: "Against full" }).click();
    await page.getByText("The full surface is on the left").waitFor();
    const now = await rested(page);
    assert.ok(messages.slice(sent).some(({ type, triangles }) => type === "edit" && triangles?.share === 1));
    assert.deepEqual(now.edit.triangles, { share: 0.25, max: 1_000_000 }, "the values are as before");
    const [full, decimated] = await page.locator(".scene-swipe span").allTextContents();
    const count = (text) => Number(/([\d,]+) triangles/.exec(text)[1].replaceAll(",", ""));
    assert.equal(count(decimated), now.triangles);
    assert.ok(count(full) > 1.5 * now.triangles, full);

    await card("Export").click();
    await page.getByRole("textbox", { name: "Caption" }).fill("A bumpy ball");
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save PNG" }).click()]);
    const image = PNG.sync.read(readFileSync(await download.path()));
    const { width, height } = await page.locator(".viewport canvas").boundingBox();
    assert.deepEqual([image.width, image.height], [2 * Math.round(width), 2 * Math.round(height)]);
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("a page says that it is loading while its program is on its way", async () => {
    const page = await at.browser.newPage({ colorScheme: "light" });
    let pass;
    const held = new Promise((done) => (pass = done));
    await page.route("**/assets/index-*.js", async (route) => {
      await held;
      await route.continue();
    });
    await page.goto(at.server.url, { waitUntil: "commit" });
    const loading = page.getByText("Loading isopeel");
    await loading.waitFor();
    // The text is in the page itself, its style sheet a file that comes after: until then nothing is painted.
    await page.waitForFunction(() => getComputedStyle(document.body).backgroundColor === "rgb(255, 255, 255)");
    pass();
    await settled(page);
    assert.equal(await loading.count(), 0);
    await page.close();
  });

  test("the tour comes once, and can be left", MORE, async () => {
    const { page, faults } = await openAt("desktop", "dark", { tour: true });
    await settled(page);
    const tour = page.getByRole("dialog", { name: "Tour" });
    await tour.getByText("1 of 3").waitFor();
    await tour.getByRole("button", { name: "Next" }).click();
    await tour.getByText("2 of 3").waitFor();
    await saveScreenshot(page, "tour");
    assert.deepEqual(await violations(page), []);
    // The help takes its place, without the edges that it draws, and it goes on where it was.
    const hasEdges = (expected) => page.waitForFunction((is) => location.hash.includes("wire=") === is, expected);
    await hasEdges(true);
    await page.getByRole("button", { name: "Help" }).click();
    await tour.waitFor({ state: "hidden" });
    await hasEdges(false);
    await page.keyboard.press("Escape");
    await tour.getByText("2 of 3").waitFor();
    await hasEdges(true);
    await tour.getByRole("button", { name: "Skip" }).click();
    await tour.waitFor({ state: "hidden" });
    await page.reload();
    await settled(page);
    await page.waitForTimeout(500);
    assert.equal(await tour.isVisible(), false);
    assert.deepEqual(faults, []);
    await page.context().close();
  });

  test("single keys act in the picture and where nothing has the focus, unless they are restricted to the picture", MORE, async () => {
    const { page } = await openAt("desktop", "dark");
    const first = (await settled(page)).camera.fitted;
    assert.equal(await page.evaluate(() => document.activeElement === document.body), true);
    await page.keyboard.press("f");
    assert.equal((await status(page)).camera.fitted, first + 1, "a page just opened");
    await page.keyboard.press("?");
    const onlyPicture = page.getByRole("switch", { name: "Single keys act without a click into the picture" });
    await onlyPicture.press("Space");
    await page.keyboard.press("Escape");
    await page.locator("dialog").waitFor({ state: "detached" });
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("f");
    assert.equal((await status(page)).camera.fitted, first + 1, "restricted to the picture");
    const { camera } = await status(page);
    await page.getByRole("slider", { name: "Triangles" }).focus();
    await page.keyboard.press("f");
    await page.keyboard.press("?");
    assert.equal((await status(page)).camera.fitted, camera.fitted);
    await page.locator(".viewport canvas").focus();
    await page.keyboard.press("f");
    assert.equal((await status(page)).camera.fitted, camera.fitted + 1);
    await page.keyboard.press("?");
    const help = page.getByRole("dialog", { name: "isopeel" });
    await help.waitFor();
    const links = await help.getByRole("link").evaluateAll((all) => all.map(({ href }) => href));
    assert.ok(links.length > 4, `${links}`);
    for (const link of links) {
      const answer = await page.request.get(link);
      assert.equal(answer.status(), 200, link);
      assert.match(answer.headers()["content-type"], /^(text\/plain; charset=utf-8|application\/json)/, link);
    }
    await page.context().close();
  });

  test("without WebGL there are an explanation and the meshes", MORE, async () => {
    const page = await at.browser.newPage();
    await page.addInitScript(() => (HTMLCanvasElement.prototype.getContext = () => null));
    await page.goto(at.server.url);
    await page.getByText("isopeel cannot draw here").waitFor();
    assert.deepEqual(await violations(page), []);
    const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "STL" }).click()]);
    assert.ok(readFileSync(await download.path()).readUInt32LE(80) > 500);
    await page.close();
  });
});
