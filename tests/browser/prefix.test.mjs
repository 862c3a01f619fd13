/** A server behind a proxy that offers it below a path of another address, as `--public-url` says. */

import assert from "node:assert/strict";
import { createServer, request } from "node:http";
import { test } from "node:test";
import { makeVolume, openPage, settled, startBrowser, startServer, TIMEOUT_MS } from "./harness.mjs";

const PREFIX = "/lab/volumes";

/** Takes the prefix off each path, and passes on requests and streams. `port` is that of the server, as soon as it is known. */
function startProxy() {
  const proxy = { port: 0 };
  const pass = (incoming, answered) => {
    if (!incoming.url.startsWith(`${PREFIX}/`)) return undefined;
    const { method, headers, socket } = incoming;
    const path = incoming.url.slice(PREFIX.length);
    const forwarded = { ...headers, "x-forwarded-for": socket.remoteAddress };
    return request({ host: "127.0.0.1", port: proxy.port, method, path, headers: forwarded }, answered);
  };
  const server = createServer((incoming, outgoing) => {
    const asked = pass(incoming, (answer) => {
      outgoing.writeHead(answer.statusCode, answer.headers);
      answer.pipe(outgoing);
    });
    if (asked === undefined) outgoing.writeHead(404).end();
    else incoming.pipe(asked.on("error", () => outgoing.destroy()));
  });
  server.on("upgrade", (incoming, socket) => {
    const asked = pass(incoming, () => socket.destroy());
    asked?.on("upgrade", (answer, other, head) => {
      const lines = Object.entries(answer.headers).map(([name, value]) => `${name}: ${value}\r\n`);
      socket.write(`HTTP/1.1 101 Switching Protocols\r\n${lines.join("")}\r\n`);
      other.write(head);
      other.pipe(socket).pipe(other);
      for (const end of [socket, other]) end.on("error", () => [socket, other].forEach((each) => each.destroy()));
    });
    asked?.on("error", () => socket.destroy());
    asked?.end();
  });
  return new Promise((done) => {
    server.listen(0, "127.0.0.1", () => {
      proxy.url = `http://localhost:${server.address().port}${PREFIX}`;
      proxy.stop = () => {
        server.closeAllConnections();
        server.close();
      };
      done(proxy);
    });
  });
}

test("the viewer works below a path of a proxy's address, with a token", { timeout: 4 * TIMEOUT_MS }, async () => {
  const volume = makeVolume();
  const proxy = await startProxy();
  const server = await startServer([volume.path], { options: ["--public-url", proxy.url, "--trusted-proxy", "127.0.0.1"] });
  proxy.port = server.port;
  const browser = await startBrowser();
  try {
    const { page, faults } = await openPage(browser, proxy.url + server.secret);
    await settled(page);
    await page.waitForFunction(() => window.location.hash.startsWith("#v=1"));
    assert.ok(page.url().startsWith(`${proxy.url}/#v=1&volume=bumpy`), page.url());
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
    await server.stop();
    proxy.stop();
    volume.remove();
  }
});
