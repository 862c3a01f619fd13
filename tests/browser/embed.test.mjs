/** The viewer in a frame of another page, and what the two tell each other. */

import assert from "node:assert/strict";
import { after, test } from "node:test";
import { createServer } from "node:http";
import { PNG } from "pngjs";
import { makeVolume, MORE, openPage, saveScreenshot, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

/** Sends requests to the frame and keeps what comes from it. */
const HOST = `<!doctype html><title>host</title><iframe id="viewer" width="900" height="640"></iframe>
<script>
  const frame = document.getElementById("viewer");
  const events = [];
  const replies = new Map();
  let last = 0;
  addEventListener("message", ({ data, source }) => {
    if (source !== frame.contentWindow || data?.isopeel !== 1) return;
    if (data.type === "reply") replies.get(data.id)?.(data);
    else events.push(data);
  });
  function ask(request) {
    const id = (last += 1);
    const reply = new Promise((found) => replies.set(id, found));
    frame.contentWindow.postMessage({ isopeel: 1, id, ...request }, "*");
    return reply;
  }
</script>`;

const hosts = createServer((_request, response) => response.setHeader("content-type", "text/html").end(HOST));
await new Promise((listening) => hosts.listen(0, "127.0.0.1", listening));
const host = `http://127.0.0.1:${hosts.address().port}`;
const at = setUp(makeVolume, { options: ["--no-auth", "--embed-origin", host] });

after(() => hosts.close());

/** A page with the viewer in it, and what it asks and hears. */
async function embed(query, hash = "") {
  const { page, faults } = await openPage(at.browser, host);
  await page.evaluate((url) => (document.getElementById("viewer").src = url), `${at.server.url}/?${query}${hash}`);
  const frame = page.frameLocator("#viewer");
  await frame.locator(".viewport canvas").waitFor();
  return {
    page,
    faults,
    frame,
    ask: (request) => page.evaluate((request) => ask(request), request),
    heard: (type, count = 1) => page.waitForFunction(([type, count]) => events.filter((event) => event.type === type)[count - 1], [type, count], { polling: 50 }).then((found) => found.jsonValue()),
  };
}

test("a page around asks, changes, moves and takes pictures", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults, frame, ask, heard } = await embed(`embed&origin=${host}`, "#volume=bumpy&color=transfer");
  assert.deepEqual((await heard("ready")).volumes, [{ id: "bumpy", title: "bumpy" }]);
  const first = await heard("settled");
  assert.ok(first.triangles > 500 && first.triangles <= first.fullTriangles, JSON.stringify(first));
  assert.match(first.link, /^v=1&volume=bumpy&.*color=transfer&camera=/);

  // Nothing but the picture, what its colours mean, and the way out.
  for (const chrome of [".top", ".inspector", ".tour", ".card"]) assert.equal(await frame.locator(chrome).count(), 0, chrome);
  await frame.locator(".scene-colors").waitFor();
  await saveScreenshot(page, "embedded");

  const changed = await ask({ type: "change", values: { iso: 3, wire: 1 } });
  assert.deepEqual(changed, { isopeel: 1, type: "reply", id: 1, ok: true, value: {} });
  await page.waitForFunction((before) => events.some((event) => event.type === "settled" && event.triangles < before), first.triangles, { polling: 50 });
  const { value: state } = await ask({ type: "get" });
  assert.match(state.link, /iso=3&.*wire=1/);

  await ask({ type: "camera", position: [100, 20, 30], target: [25, 23, 22] });
  await page.waitForFunction(async () => Math.abs((await ask({ type: "camera" })).value.position[0] - 100) < 0.5, null, { polling: 100 });
  const whole = frame.getByRole("link", { name: "Open in isopeel" });
  await whole.hover();
  assert.match(await whole.getAttribute("href"), new RegExp(`^${at.server.url}/#v=1&volume=bumpy&.*iso=3`));

  const png = await page.evaluate(async () => {
    const { ok, value } = await ask({ type: "image", scale: 2, caption: "In a frame" });
    return ok ? [value.type, [...new Uint8Array(await value.arrayBuffer())]] : [];
  });
  assert.equal(png[0], "image/png");
  const { width, height } = PNG.sync.read(Buffer.from(png[1]));
  assert.deepEqual([width, height], [1800, 1280]);

  const refused = async (request) => (await ask(request)).error;
  assert.equal(await refused({ type: "set", link: "volume=head" }), 'there is no volume "head". There are: bumpy');
  assert.equal(await refused({ type: "set", link: "volume=bumpy&iso=high" }), "This link's “iso” is \"high\", expected a number");
  assert.match(await refused({ type: "change", values: { isovalue: 3 } }), /^A link has no “isovalue”\. It has: v, volume/);
  assert.equal(await refused({ type: "jump" }), 'type is "jump", expected one of get, set, change, camera, image, token');
  // What the server refuses comes as an event.
  await ask({ type: "set", link: "volume=bumpy&alpha=7" });
  assert.match((await heard("error")).message, /alpha/);
  assert.deepEqual(faults, []);
  await page.close();
});

test("a page of an origin that is not named is refused, and hears nothing", { ...MORE, timeout: 2 * TIMEOUT_MS }, async () => {
  const { page, frame, ask } = await embed("embed&origin=https://lab.example", "#volume=bumpy");
  await frame.locator(".scene-scale").waitFor();
  const reply = await ask({ type: "get" });
  assert.deepEqual([reply.ok, reply.error], [false, `isopeel takes no messages from ${host}: the address has to name it: ?embed&origin=${host}`]);
  assert.deepEqual(await page.evaluate(() => events), []);
  await page.close();
});
