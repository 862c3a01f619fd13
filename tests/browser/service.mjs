/** What docs/operations.md has of nginx and systemd, as it stands there. `make test-service` runs it; it takes nginx, openssl and systemd-analyze. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { test } from "node:test";
import { BINARY, makeVolume, openPage, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";
import { freePort, makeCertificate, startNginx } from "./proxies.mjs";

const PART_BYTES = 2 << 20;

/** A block of the page, with other values in place of some, each of which is there once. */
function documented(language, others) {
  const page = readFileSync(resolve(import.meta.dirname, "../../docs/operations.md"), "utf8");
  const block = new RegExp(`\`\`\`${language}\\n([^]*?)\`\`\``).exec(page)?.[1];
  assert.ok(block !== undefined, `docs/operations.md has no ${language}`);
  return Object.entries(others).reduce((text, [before, now]) => {
    assert.equal(text.split(before).length, 2, before);
    return text.replace(before, now);
  }, block);
}

/** An nginx with the lines of the page. */
function startDocumentedNginx(folder, port, serverPort) {
  const { certificate, key } = makeCertificate(folder);
  const site = documented("nginx", {
    "listen 443 ssl": `listen 127.0.0.1:${port} ssl`,
    "server_name lab.example": "server_name localhost",
    "/etc/ssl/lab.pem": certificate,
    "/etc/ssl/lab.key": key,
    "127.0.0.1:8417": `127.0.0.1:${serverPort}`,
  });
  return startNginx(folder, port, site);
}

test("the viewer works behind nginx, and what is large or takes long comes through", { timeout: 4 * TIMEOUT_MS }, async () => {
  const [volume, folder] = [makeVolume(), mkdtempSync(join(tmpdir(), "isopeel-nginx-"))];
  const port = await freePort();
  const url = `https://localhost:${port}/volumes`;
  const options = ["--public-url", url, "--trusted-proxy", "127.0.0.1", "--uploads", join(folder, "uploads"), "--state-folder", join(folder, "state")];
  const server = await startServer([volume.path], { options });
  const nginx = await startDocumentedNginx(folder, port, server.port);
  const browser = await startBrowser();
  try {
    const context = await browser.newContext({ ignoreHTTPSErrors: true });
    const { page, faults, messages } = await openPage(context, url + server.secret);
    await settled(page);
    await page.waitForFunction(() => window.location.hash.startsWith("#v=1"));
    assert.ok(page.url().startsWith(`${url}/#v=1&volume=bumpy`), page.url());
    assert.ok(messages.some(({ type }) => type === "done"), "the stream came through");
    const [cookie] = await context.cookies();
    assert.deepEqual([cookie.secure, cookie.httpOnly], [true, true]);

    const headers = { authorization: `Bearer ${server.secret.slice(server.secret.indexOf("=") + 1)}` };
    const made = await context.request.post(`${url}/api/v1/extract`, { headers, data: { volume: "bumpy", format: "stl", iso: 5 } });
    assert.deepEqual([made.status(), (await made.body()).length > 10_000], [200, true]);

    // A part that is larger than what nginx takes by itself.
    const declared = await context.request.post(`${url}/api/v1/uploads`, { headers, data: { files: [{ name: "a.npy", bytes: PART_BYTES }] } });
    const { id } = await declared.json();
    const tus = { ...headers, "tus-resumable": "1.0.0", "upload-offset": "0", "content-type": "application/offset+octet-stream" };
    const sent = await context.request.patch(`${url}/api/v1/uploads/${id}`, { headers: tus, data: Buffer.alloc(PART_BYTES) });
    assert.deepEqual([sent.status(), sent.headers()["upload-offset"]], [204, String(PART_BYTES)]);

    // An event is there while the stream goes on.
    const extractions = Array.from({ length: 400 }, (_, n) => ({ format: "stl", iso: 1 + n / 50 }));
    const submitted = await context.request.post(`${url}/api/v1/jobs`, { headers, data: { volume: "bumpy", extractions } });
    const job = await submitted.json();
    const first = await page.evaluate(async (path) => {
      const { body } = await fetch(path);
      const reader = body.getReader();
      const { value, done } = await reader.read();
      await reader.cancel();
      return { text: new TextDecoder().decode(value), done };
    }, `/volumes/api/v1/jobs/${job.id}/events`);
    assert.match(first.text, /event: (queued|running)/);
    assert.ok(!first.text.includes("event: done"), first.text);
    await context.request.post(`${url}/api/v1/jobs/${job.id}/cancel`, { headers });
    assert.deepEqual(faults, []);
    assert.doesNotMatch(nginx.log(), /\[(emerg|alert|crit|error)\]/);
  } finally {
    await browser.close();
    await nginx.stop();
    await server.stop();
    volume.remove();
    rmSync(folder, { recursive: true });
  }
});

test("systemd reads the unit", () => {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-unit-"));
  const file = join(folder, "isopeel.service");
  writeFileSync(file, documented("ini", { "/usr/local/bin/isopeel": BINARY }));
  try {
    execFileSync("systemd-analyze", ["verify", "--man=no", "--recursive-errors=no", file], { stdio: "pipe" });
  } catch (error) {
    assert.fail(`${error.stderr ?? error.message}`);
  } finally {
    rmSync(folder, { recursive: true });
  }
});
