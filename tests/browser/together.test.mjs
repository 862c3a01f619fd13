/** Two pages in a group: what one does the other shows, and control is handed over. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { violations } from "./accessibility.mjs";
import { openPage, saveScreenshot, settled, status, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

const unfold = (page) => page.getByRole("button", { name: "Follow me" }).click();
const button = (page, name) => page.getByRole("button", { name, exact: true });

async function setIso(page, value) {
  const field = page.getByRole("textbox", { name: "Isovalue", exact: true });
  await field.fill(String(value));
  await field.press("Enter");
}

/** Turns the picture by hand. */
async function turn(page) {
  const { x, y, width, height } = await page.locator(".viewport canvas").first().boundingBox();
  await page.mouse.move(x + width / 2, y + height / 2);
  await page.mouse.down();
  await page.mouse.move(x + width / 2 + 160, y + height / 2 + 40, { steps: 4 });
  await page.mouse.up();
}

/** What is made at rest, after which nothing follows. */
const shows = (page, iso) => settled(page, (now, iso) => now.edit?.iso === iso && now.statistics?.isTreeCut && now.triangles === now.statistics.triangles, iso);
const near = (a, b) => a.every((x, axis) => Math.abs(x - b[axis]) < 1e-3 * Math.hypot(...a));

/** Waits until two pages look from the same place. */
async function sameCamera(one, other) {
  for (const began = Date.now(); Date.now() - began < TIMEOUT_MS; ) {
    const [a, b] = await Promise.all([status(one), status(other)]);
    if (near(a.camera.position, b.camera.position) && near(a.camera.target, b.camera.target)) return a.camera.position;
  }
  assert.fail("the cameras are apart");
}

test("a follower sees what the leader does, and control goes there and back", { timeout: 6 * TIMEOUT_MS }, async () => {
  const context = await at.browser.newContext();
  // So that a test can lose a connection.
  await context.addInitScript(() => {
    window.sockets = [];
    window.WebSocket = class extends WebSocket {
      constructor(...of) {
        super(...of);
        window.sockets.push(this);
      }
    };
  });
  const leader = await openPage(context, at.server.url);
  await settled(leader.page);
  await unfold(leader.page);
  await button(leader.page, "Start").click();
  await leader.page.getByText("You lead · No followers yet").waitFor();
  const started = leader.messages.find(({ type }) => type === "group");
  const link = `${at.server.url}/#follow=${started.group}`;

  await setIso(leader.page, 4);
  await shows(leader.page, 4);
  const follower = await openPage(context, link);
  await shows(follower.page, 4).catch((error) => {
    throw new Error(`${error.message}; messages: ${follower.messages.map(({ type }) => type).join(" ")}`);
  });
  await leader.page.getByText("You lead · 1 follower").waitFor();
  assert.equal(follower.page.url(), link, "what is copied is the way to the group");

  // Camera and isovalue, live.
  const before = (await status(leader.page)).camera.position;
  await turn(leader.page);
  await setIso(leader.page, 8);
  const [of, same] = [await shows(leader.page, 8), await shows(follower.page, 8)];
  assert.equal(same.triangles, of.triangles);
  assert.ok(!near(await sameCamera(leader.page, follower.page), before), "the leader has turned");
  assert.ok(!follower.messages.some(({ type }) => type === "edit" || type === "open"), "a follower asks for nothing of its own");

  // What would change the picture is off; what is about it alone is not.
  await follower.page.getByText("Following the leader · 1 follower").waitFor();
  assert.ok(await follower.page.getByRole("textbox", { name: "Isovalue", exact: true }).isDisabled());
  assert.ok(await follower.page.getByRole("combobox", { name: "Volume" }).isDisabled());
  assert.ok(await leader.page.getByRole("textbox", { name: "Isovalue", exact: true }).isEnabled());
  await button(follower.page, "Data").click();
  await follower.page.getByRole("radio", { name: "Linear" }).press("Space");
  await button(follower.page, "Data").click();

  // Alone, and back.
  await unfold(follower.page);
  await turn(follower.page);
  await follower.page.getByText("Following the leader, free camera").waitFor();
  await button(follower.page, "Follow the camera").click();
  await sameCamera(leader.page, follower.page);
  await button(follower.page, "Free camera").click();
  await turn(leader.page);
  await button(follower.page, "Follow the camera").click();
  await sameCamera(leader.page, follower.page);

  // Control goes to who asks.
  await follower.page.getByRole("textbox", { name: "Your name, for the leader" }).fill("Ann");
  await follower.page.keyboard.press("Enter");
  await button(follower.page, "Ask for control").click();
  await button(leader.page, "Give control to Ann").scrollIntoViewIfNeeded();
  await saveScreenshot(leader.page, "together-leader");
  await saveScreenshot(follower.page, "together-follower");
  assert.deepEqual(await violations(leader.page), []);
  assert.deepEqual(await violations(follower.page), []);
  await button(leader.page, "Give control to Ann").click();
  await button(follower.page, "Give it back").waitFor();
  await setIso(follower.page, 2);
  await Promise.all([shows(follower.page, 2), shows(leader.page, 2)]);
  await turn(follower.page);
  await sameCamera(leader.page, follower.page);

  // The leader's connection is lost, and it comes back: the group is the same, and so is who has control.
  await leader.page.evaluate(() => window.sockets.at(-1).close());
  await follower.page.getByText("The leader is back").waitFor();
  assert.ok(follower.messages.some(({ leaderAway }) => leaderAway === true), "the group has waited");
  assert.ok(leader.messages.some(({ type, resume }) => type === "lead" && resume?.group === started.group));
  await setIso(follower.page, 3);
  await Promise.all([shows(follower.page, 3), shows(leader.page, 3)]);

  // Control comes back when its holder leaves, and with it the leader's next connection is followed.
  await follower.page.close();
  await leader.page.getByText("You lead · No followers yet").waitFor();
  const other = await openPage(context, link);
  await leader.page.getByText("You lead · 1 follower").waitFor();
  await setIso(leader.page, 6);
  await Promise.all([shows(leader.page, 6), shows(other.page, 6)]);
  await leader.page.evaluate(() => window.sockets.at(-1).close());
  await other.page.getByText("The leader is back").waitFor();
  await setIso(leader.page, 5);
  await Promise.all([shows(leader.page, 5), shows(other.page, 5)]);
  await turn(leader.page);
  await sameCamera(leader.page, other.page);

  // The leader's page is loaded anew: it leads on with what its address has, and what it comes back with is kept nowhere.
  const seen = other.messages.length;
  const isBack = ({ type, leaderAway }) => type === "group" && leaderAway === false;
  await leader.page.reload();
  for (const began = Date.now(); !other.messages.slice(seen).some(isBack); ) {
    assert.ok(Date.now() - began < TIMEOUT_MS, "the leader is not back");
    await new Promise((done) => setTimeout(done, 50));
  }
  assert.ok(other.messages.slice(seen).some(({ leaderAway }) => leaderAway === true), "the group has waited");
  assert.equal(await leader.page.evaluate(() => sessionStorage.length), 0);
  await setIso(leader.page, 7);
  await Promise.all([shows(leader.page, 7), shows(other.page, 7)]);
  await unfold(leader.page);
  await leader.page.getByText("You lead · 1 follower").waitFor();
  assert.ok(![...follower.messages, ...other.messages].some(({ key }) => key !== undefined), "the key is the leader's alone");
  await button(leader.page, "End").click();
  await other.page.getByText("The group has ended").waitFor();
  await button(leader.page, "Start").waitFor();
  assert.deepEqual([...leader.faults, ...follower.faults, ...other.faults], []);
  await context.close();
});
