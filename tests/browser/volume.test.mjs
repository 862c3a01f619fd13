/** The volume along the rays of the picture: around and behind the surface, with the isovalue marked, in links, and what is said if it does not come. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { cameraAtRest, difference, frameAfter, openPage, picture, rested, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

/** The ball is in the middle of the picture, and all of the volume is in it. */
const CAMERA = "camera=25,-130,22,25,23.5,22";
const at = setUp();

async function open(link, options = {}) {
  const opened = await openPage(at.browser, `${at.server.url}/#volume=bumpy&axes=0&scale=0&${CAMERA}&${link}`, options);
  await rested(opened.page);
  await cameraAtRest(opened.page);
  return opened;
}

/** Has the page follow another link, and waits until all of it is in the picture. */
async function follow(page, link) {
  const { framesDrawn } = await status(page);
  await page.evaluate((hash) => (window.location.hash = hash), `volume=bumpy&axes=0&scale=0&${CAMERA}&${link}`);
  await frameAfter(page, framesDrawn);
  await page.waitForTimeout(300);
  await rested(page);
  await cameraAtRest(page);
}

/** Opens a page that shows the surface, and then the volume too. */
async function openWith(link, options) {
  const opened = await open("iso=0", options);
  await follow(opened.page, link);
  return opened;
}

const unfold = (page) => page.getByRole("button", { name: "Volume", exact: true }).and(page.locator(".card-head")).click();

/** Pixels of about the colour of what is marked: much more red than blue. */
function marked({ data }) {
  let count = 0;
  for (let i = 0; i < data.length; i += 4) if (data[i] - data[i + 2] > 70) count += 1;
  return count;
}

test("the volume is around the surface and behind it, and where it is behind it is hidden", { timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("iso=0");
  const before = await picture(page);
  const modes = [];
  page.on("response", (response) => {
    if (response.url().includes("/overview?")) modes.push(new URL(response.url()).searchParams.get("mode"));
  });
  /** The same page follows one link after the other; `count` overviews have come by then. */
  const pictureOf = async (link, count) => {
    await follow(page, link);
    assert.equal(modes.length, count, link);
    return picture(page);
  };
  // Values above 2 are more than 13 samples from the surface's outside: behind all of it.
  const inside = await pictureOf("iso=0&vr=maximum&vrwindow=2,15", 1);
  assert.ok(difference(before, inside) < 0.0005, `${difference(before, inside)} of the picture differs, though all of it is hidden`);
  const cloud = await pictureOf("iso=0&vr=rendering&vrwindow=2,15", 2);
  assert.ok(difference(before, cloud) < 0.0005, `${difference(before, cloud)} differs by a hidden cloud`);
  // Those below 0 are around it.
  const around = await pictureOf("iso=0&vr=maximum&vrwindow=-30,0&vrmark=0", 2);
  assert.ok(difference(before, around) > 0.1, `${difference(before, around)} differs`);
  const fog = await pictureOf("iso=0&vr=rendering&vrwindow=-30,0&vropacity=1", 2);
  assert.ok(difference(around, fog) > 0.05, `${difference(around, fog)}: a cloud is before the surface too`);
  const through = await pictureOf("iso=0&opacity=0.3&vr=rendering&vrwindow=2,15&vropacity=1", 2);
  assert.ok(marked(through) > 2000, `${marked(through)} marked pixels behind a translucent surface`);
  assert.deepEqual(modes, ["maximum", "mean"], "an overview is loaded once");
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("values from the isovalue on are marked at once, and nothing is drawn while nothing changes", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await open("iso=0&opacity=0");
  const requests = [];
  page.on("request", (request) => requests.push(request.url()));
  await unfold(page);
  const { framesDrawn } = await status(page);
  assert.equal(requests.some((url) => url.includes("/overview")), false, "it is not loaded before it is shown");
  const overview = (url) => url.includes("/overview?step=0&field=depth&mode=maximum");
  // A frame may also be drawn for the pointer, before the request.
  const requested = page.waitForRequest((request) => overview(request.url()));
  await page.getByRole("radiogroup", { name: "Volume" }).getByText("Maximum", { exact: true }).click();
  await requested;
  await frameAfter(page, framesDrawn);
  assert.equal(requests.filter(overview).length, 1);
  await page.getByRole("textbox", { name: "Isovalue" }).first().fill("5");
  await page.keyboard.press("Enter");
  await settled(page, (now) => now.edit.iso === 5);
  await cameraAtRest(page);
  const wide = marked(await picture(page));
  await page.getByRole("textbox", { name: "Isovalue" }).first().fill("11");
  await page.keyboard.press("Enter");
  await settled(page, (now) => now.edit.iso === 11);
  await cameraAtRest(page);
  const narrow = marked(await picture(page));
  // Balls of radius 10 and 4.
  assert.ok(wide > 4 * narrow && wide < 9 * narrow && narrow > 100, `${wide} and ${narrow} marked pixels, expected about 6 times as many`);
  await page.getByRole("switch", { name: "Mark values from the isovalue on" }).press("Space");
  await cameraAtRest(page);
  assert.equal(marked(await picture(page)), 0);
  await rested(page);
  const { framesDrawn: still } = await status(page);
  await page.waitForTimeout(1500);
  assert.equal((await status(page)).framesDrawn, still, "frames while nothing changes");
  await page.waitForFunction(() => /vr=maximum.*vrmark=0/.test(window.location.hash));
  await page.getByRole("radiogroup", { name: "Volume" }).getByText("Off", { exact: true }).click();
  await page.waitForFunction(() => !window.location.hash.includes("vr=maximum"));
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("the card has a window that is dragged, and is for everyone", { timeout: 3 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openWith("iso=0&vr=rendering");
  await unfold(page);
  const low = page.getByRole("slider", { name: "Lower end of the window" });
  const first = Number(await low.getAttribute("aria-valuenow"));
  await low.press("Shift+ArrowRight");
  await low.press("Shift+ArrowRight");
  assert.ok(Number(await low.getAttribute("aria-valuenow")) > first);
  const upper = page.getByRole("slider", { name: "Upper end of the window" });
  await upper.press("Home");
  const ends = await Promise.all([low, upper].map((one) => one.getAttribute("aria-valuenow").then(Number)));
  assert.ok(ends[0] < ends[1], `${ends}: the ends do not pass each other`);
  await page.getByRole("button", { name: "Usual window" }).click();
  await low.waitFor();
  assert.equal(Number(await low.getAttribute("aria-valuenow")), first);
  for (const theme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme: theme });
    await page.locator(`html[data-theme=${theme}]`).waitFor();
    assert.deepEqual(await violations(page), [], theme);
    await cameraAtRest(page);
    await saveScreenshot(page, `volume-${theme}`);
  }
  assert.deepEqual(faults, []);
  await page.context().close();
});

test("a server that refuses is asked once, and the page says why", { timeout: 2 * TIMEOUT_MS }, async () => {
  const { page } = await open("iso=0");
  let asked = 0;
  await page.route("**/overview?*", (route) => {
    asked += 1;
    return route.fulfill({ status: 503, contentType: "application/problem+json", body: JSON.stringify({ status: 503, code: "busy", title: "Busy", detail: "6 overviews are being made" }) });
  });
  await unfold(page);
  await page.getByRole("radiogroup", { name: "Volume" }).getByText("Maximum", { exact: true }).click();
  await page.getByText("The volume cannot be shown: 6 overviews are being made").waitFor();
  await page.getByRole("switch", { name: "Mark values from the isovalue on" }).press("Space");
  await page.waitForTimeout(300);
  assert.equal(asked, 1);
  await page.context().close();
});
