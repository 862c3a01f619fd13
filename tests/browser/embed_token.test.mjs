/** The viewer in a frame of another site's page, which hands it a token: no cookie is sent there. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { createServer } from "node:http";
import { makeVolume, MORE, openPage, saveScreenshot, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

/** Hands over what `/token` answers, which is what its server has got, and keeps what comes from the frame. */
const host = (server, query, more) => `<!doctype html><title>host</title><iframe id="viewer" width="700" height="500"></iframe>${more}
<script>
  const server = "${server}";
  const frame = document.getElementById("viewer");
  const events = [];
  const strangers = [];
  const replies = [];
  addEventListener("message", async ({ data, origin, source }) => {
    if (data?.isopeel !== 1) return;
    if (origin !== server || source !== frame.contentWindow) return void strangers.push({ data, origin });
    if (data.type === "reply") return void replies.push(data);
    events.push(data);
    if (data.type !== "token" || location.search.includes("silent")) return;
    const token = await (await fetch("/token")).text();
    ask({ type: "token", token });
  });
  function ask(request) {
    frame.contentWindow.postMessage({ isopeel: 1, id: replies.length, ...request }, server);
  }
  frame.src = server + "/?${query}#volume=bumpy";
</script>`;

/** Posts what it was given to the viewer beside it, and keeps what it hears. */
const evil = (token) => `<!doctype html><title>evil</title><script>
  const heard = [];
  addEventListener("message", ({ data }) => heard.push(data));
  setInterval(() => {
    parent.frames[0].postMessage({ isopeel: 1, id: 1, type: "token", token: ${JSON.stringify(token)} }, "*");
    parent.frames[0].postMessage({ isopeel: 1, id: 2, type: "get" }, "*");
  }, 100);
</script>`;

const at = { lifetimes: [], made: [] };

/** A server of another site: 127.0.0.1 and localhost are two. */
async function site(pages) {
  const pagesServer = createServer(async (request, response) => {
    response.setHeader("content-type", "text/html");
    response.end(await pages(new URL(request.url, "http://localhost")));
  });
  await new Promise((listening) => pagesServer.listen(0, "localhost", listening));
  return { origin: `http://localhost:${pagesServer.address().port}`, close: () => pagesServer.close() };
}

/** What the server of a site does: it has a token, and asks for one that is for less. */
async function lend(seconds = 600) {
  const response = await fetch(`${at.server.url}/api/v1/embed-tokens`, {
    method: "POST",
    headers: { authorization: `Bearer ${at.server.secret.split("token=")[1]}`, "content-type": "application/json" },
    body: JSON.stringify({ roles: ["view"], seconds }),
  });
  const made = await response.json();
  assert.deepEqual([response.status, made.roles, made.expiresSeconds], [201, ["view"], seconds], JSON.stringify(made));
  at.made.push(made.token);
  return made.token;
}

before(async () => {
  at.volume = makeVolume();
  at.evil = await site(async (url) => (url.pathname === "/host" ? host(at.server.url, `embed&origin=${at.evil.origin}`, "") : evil(await lend())));
  at.lab = await site(async (url) => {
    if (url.pathname === "/token") return lend(at.lifetimes.shift());
    const isNested = url.searchParams.has("nested");
    const query = url.searchParams.has("unnamed") ? "embed" : `embed&origin=${at.lab.origin}`;
    return host(at.server.url, query, isNested ? `<iframe id="evil" src="${at.evil.origin}/"></iframe>` : "");
  });
  at.server = await startServer([at.volume.path], { options: ["--embed-origin", at.lab.origin] });
  at.browser = await startBrowser();
});

after(async () => {
  await at.browser?.close();
  await at.server?.stop();
  at.lab?.close();
  at.evil?.close();
  at.volume?.remove();
});

/** A page, and all addresses that it has asked for. */
async function open(url) {
  const context = await at.browser.newContext();
  const addresses = [];
  context.on("request", (request) => addresses.push(request.url()));
  context.on("page", (page) => page.on("websocket", (socket) => addresses.push(socket.url())));
  // There is no tour in a frame, and storage may be closed to it.
  const { page, faults } = await openPage(context, url, { tour: true });
  const counted = (type) => page.waitForFunction((type) => events.filter((event) => event.type === type).length, type).then((found) => found.jsonValue());
  return { context, page, faults, addresses, counted, frame: page.frameLocator("#viewer") };
}

test("a page hands a token to the frame, which asks for the next one before it ends", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  // The first one is asked for anew after ten seconds.
  at.lifetimes.push(20);
  const { context, page, faults, addresses, frame, counted } = await open(`${at.lab.origin}/`);
  await counted("settled");
  const first = await page.evaluate(() => ({ reasons: events.filter(({ type }) => type === "token").map(({ reason }) => reason), replies }));
  // On a slow machine more than ten seconds have passed.
  assert.deepEqual(first.reasons.filter((reason) => reason !== "expiring"), ["wanted"]);
  assert.deepEqual([first.replies[0].ok, first.replies[0].value.roles], [true, ["view"]], JSON.stringify(first.replies));
  await saveScreenshot(page, "embedded-token");
  await page.waitForFunction(() => replies.length === 2 && events.some(({ reason }) => reason === "expiring"));
  // The picture stays, and is of a new stream.
  const streams = () => addresses.filter((address) => address.startsWith("ws:") && address.includes("ticket="));
  for (const began = Date.now(); streams().length < 2; ) {
    assert.ok(Date.now() - began < TIMEOUT_MS, "no second stream");
    await new Promise((done) => setTimeout(done, 50));
  }
  assert.equal(new Set(streams()).size, streams().length, "a ticket each");
  // What the first was good for has ended, what the second is good for has not.
  for (const began = Date.now(); (await sessionOf(at.made.at(-2))) !== 401; ) {
    assert.ok(Date.now() - began < 25_000, "the first has not ended");
    await new Promise((done) => setTimeout(done, 200));
  }
  assert.equal(await sessionOf(at.made.at(-1)), 200);
  await page.evaluate(() => ask({ type: "get" }));
  const got = await page.waitForFunction(() => replies[2]);
  assert.equal((await got.jsonValue()).ok, true);
  assert.equal(await frame.locator(".banner").count(), 0, "nobody was told that a connection was lost");
  assert.deepEqual(await page.evaluate(() => events.filter(({ type }) => type === "error")), []);

  // It is in no place that is kept or seen by others.
  const viewer = page.frames().find((one) => one.url().startsWith(at.server.url));
  const kept = await viewer.evaluate(() => {
    // Storage of a page in a frame of another site may be closed to it.
    const stored = ["localStorage", "sessionStorage"].map((name) => {
      try {
        return { ...window[name] };
      } catch (error) {
        if (error.name !== "SecurityError") throw error;
        return {};
      }
    });
    return JSON.stringify([stored, document.cookie, history.state, location.href, document.referrer]);
  });
  const link = await frame.getByRole("link", { name: "Open in isopeel" }).getAttribute("href");
  for (const token of at.made.slice(-2)) {
    for (const seen of [kept, link, at.server.log(), ...addresses]) assert.ok(!seen.includes(token.slice(6)), seen);
  }
  assert.deepEqual(await context.cookies(), []);
  assert.deepEqual(await page.evaluate(() => strangers), []);
  assert.deepEqual(faults, []);
  await context.close();
});

/** The status with which a token is answered. */
async function sessionOf(token) {
  return (await fetch(`${at.server.url}/api/v1/session`, { headers: { authorization: `Bearer ${token}` } })).status;
}

test("of others no token is taken, and nobody else is asked for one", { timeout: 4 * TIMEOUT_MS }, async () => {
  // A frame of another site beside the viewer has a good token, and the page around has none.
  const { context, page, frame, counted } = await open(`${at.lab.origin}/?silent&nested`);
  await counted("token");
  await frame.getByText("which the page around this picture has to hand over").waitFor();
  await new Promise((done) => setTimeout(done, 1000));
  const beside = page.frames().find((one) => one.url() === `${at.evil.origin}/`);
  assert.deepEqual(await beside.evaluate(() => heard), []);
  assert.deepEqual(await page.evaluate(() => [replies, events.filter(({ type }) => type !== "token")]), [[], []]);
  // A token that is none.
  await page.evaluate(() => ask({ type: "token", token: "isop_0123456789ab_wrong" }));
  const refused = await page.waitForFunction(() => replies[0]);
  assert.match((await refused.jsonValue()).error, /the server does not take this token/);
  await context.close();

  // The address does not name the page around: it hears nothing, and what it says is refused.
  const unnamed = await open(`${at.lab.origin}/?unnamed&silent`);
  await unnamed.frame.getByText("which the page around this picture has to hand over").waitFor();
  await unnamed.page.evaluate(async () => ask({ type: "token", token: await (await fetch("/token")).text() }));
  const answer = await unnamed.page.waitForFunction(() => replies[0]);
  assert.match((await answer.jsonValue()).error, /isopeel takes no messages from http:\/\/localhost/);
  assert.deepEqual(await unnamed.page.evaluate(() => events), []);
  await unnamed.context.close();

  // A page that the operator has not named does not even have the frame, whatever the address says.
  const foreign = await open(`${at.evil.origin}/host`);
  await foreign.page.waitForFunction(() => document.readyState === "complete");
  await new Promise((done) => setTimeout(done, 500));
  assert.ok(!foreign.page.frames().some((one) => one.url().startsWith(at.server.url)), "the browser has it");
  assert.deepEqual(await foreign.page.evaluate(() => [events, replies, strangers]), [[], [], []]);
  await foreign.context.close();
});
