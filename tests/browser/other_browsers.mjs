/** Firefox by WebDriver BiDi and WebKitGTK by WebDriver, as Debian has them: a page in each, without playwright's own builds. */

import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import WebSocket from "ws";
import { TIMEOUT_MS } from "./harness.mjs";

const FIREFOX = process.env.FIREFOX ?? "/usr/bin/firefox-esr";
const WEBKIT_DRIVER = process.env.WEBKIT_DRIVER ?? "/usr/bin/WebKitWebDriver";
const XVFB = "/usr/bin/Xvfb";
const SIZE = { width: 1100, height: 760 };

/** Names of what is missing for a browser. */
export const missing = {
  firefox: [FIREFOX, XVFB].filter((path) => !existsSync(path)),
  webkit: [WEBKIT_DRIVER, XVFB].filter((path) => !existsSync(path)),
};

/** A program, and the first of its lines that matches. */
async function started(program, args, { pattern, from = "stderr", env = {} }) {
  const child = spawn(program, args, { env: { ...process.env, ...env }, stdio: ["ignore", "pipe", "pipe"] });
  const end = () => new Promise((done) => (child.exitCode !== null || child.signalCode !== null ? done() : child.once("exit", done) && child.kill()));
  const lines = [];
  try {
    const match = await new Promise((found, failed) => {
      for (const stream of [child.stdout, child.stderr])
        createInterface(stream).on("line", (line) => {
          lines.push(line);
          const here = stream === child[from] ? pattern.exec(line) : null;
          if (here !== null) found(here);
        });
      child.on("error", failed);
      child.on("exit", (code) => failed(new Error(`${program} ended (${code}):\n${lines.join("\n")}`)));
      setTimeout(() => failed(new Error(`${program} said nothing of ${pattern}:\n${lines.join("\n")}`)), TIMEOUT_MS).unref();
    });
    return { match, end };
  } catch (error) {
    await end();
    throw error;
  }
}

/** An expression or a promise of one, as text that a page can evaluate: what it gives comes back as JSON. */
const asJson = (expression) => `Promise.resolve(${expression}).then((value) => JSON.stringify(value ?? null))`;

/** A screen in memory: neither browser gives its pages WebGL without one. */
const startScreen = async () => {
  const { match, end } = await started(XVFB, ["-displayfd", "1", "-screen", "0", "1280x1024x24", "-nolisten", "tcp"], { pattern: /^(\d+)$/, from: "stdout" });
  return { env: { DISPLAY: `:${match[1]}`, GDK_BACKEND: "x11", LIBGL_ALWAYS_SOFTWARE: "1" }, end };
};

export async function openFirefox() {
  const profile = mkdtempSync(join(tmpdir(), "isopeel-firefox-"));
  // A processor is no graphics device that Firefox would trust by itself.
  writeFileSync(join(profile, "user.js"), 'user_pref("webgl.force-enabled", true);\n');
  const screen = await startScreen();
  const args = ["--no-remote", "--profile", profile, "--remote-debugging-port", "0", "about:blank"];
  const { match, end } = await started(FIREFOX, args, { pattern: /WebDriver BiDi listening on (ws:\S+)/, env: screen.env });
  const socket = new WebSocket(`${match[1]}/session`);
  await new Promise((open, failed) => socket.once("open", open).once("error", failed));
  const waiting = new Map();
  const faults = [];
  socket.on("message", (data) => {
    const { type, id, result, error, message, method, params } = JSON.parse(data);
    if (type === "event" && method === "log.entryAdded" && params.level === "error") faults.push(params.text);
    const asked = waiting.get(id);
    waiting.delete(id);
    if (type === "success") asked?.found(result);
    if (type === "error") asked?.failed(new Error(`${error}: ${message}`));
  });
  let last = 0;
  const send = (method, params) =>
    new Promise((found, failed) => {
      waiting.set(++last, { found, failed });
      socket.send(JSON.stringify({ id: last, method, params }));
    });
  await send("session.new", { capabilities: {} });
  await send("session.subscribe", { events: ["log.entryAdded"] });
  const { contexts } = await send("browsingContext.getTree", {});
  const { context } = contexts[0];
  await send("browsingContext.setViewport", { context, viewport: SIZE });
  return {
    faults,
    goto: (url) => send("browsingContext.navigate", { context, url, wait: "complete" }),
    evaluate: async (expression) => {
      const { type, result, exceptionDetails } = await send("script.evaluate", { expression: asJson(expression), target: { context }, awaitPromise: true });
      if (type !== "success") throw new Error(exceptionDetails.text);
      return JSON.parse(result.value);
    },
    screenshot: async () => Buffer.from((await send("browsingContext.captureScreenshot", { context })).data, "base64"),
    close: async () => {
      socket.close();
      await end();
      await screen.end();
      rmSync(profile, { recursive: true, force: true, maxRetries: 5, retryDelay: 200 });
    },
  };
}

/** The driver knows no console: `faults` are the page's uncaught errors from when it is loaded. */
export async function openWebKit() {
  const screen = await startScreen();
  const port = 20_000 + (process.pid % 20_000);
  const driver = spawn(WEBKIT_DRIVER, [`--port=${port}`], { env: { ...process.env, ...screen.env }, stdio: "ignore" });
  const end = async () => {
    await new Promise((done) => (driver.exitCode !== null ? done() : driver.once("exit", done) && driver.kill()));
    await screen.end();
  };
  const ask = async (path, body, method = body === undefined ? "GET" : "POST") => {
    const answer = await fetch(`http://127.0.0.1:${port}${path}`, { method, ...(body === undefined ? {} : { body: JSON.stringify(body) }) });
    const { value } = await answer.json();
    if (!answer.ok) throw new Error(`${value.error}: ${value.message}`);
    return value;
  };
  try {
    for (let tries = 0; ; tries += 1) {
      if (await ask("/status").then(() => true, () => false)) break;
      if (tries === 100) throw new Error(`${WEBKIT_DRIVER} does not answer on port ${port}`);
      await new Promise((later) => setTimeout(later, 100));
    }
    const { sessionId } = await ask("/session", { capabilities: {} });
    const at = `/session/${sessionId}`;
    await ask(`${at}/timeouts`, { script: TIMEOUT_MS, pageLoad: TIMEOUT_MS });
    await ask(`${at}/window/rect`, SIZE);
    const evaluate = async (expression) => JSON.parse(await ask(`${at}/execute/async`, { script: `${asJson(expression)}.then(arguments[0])`, args: [] }));
    const faults = [];
    return {
      faults,
      goto: async (url) => {
        await ask(`${at}/url`, { url });
        await evaluate(`(window.faults = [], addEventListener("error", ({ message }) => window.faults.push(message)), addEventListener("unhandledrejection", ({ reason }) => window.faults.push(String(reason))), true)`);
      },
      evaluate: async (expression) => {
        const found = await evaluate(expression);
        faults.splice(0, faults.length, ...(await evaluate("window.faults")));
        return found;
      },
      screenshot: async () => Buffer.from(await ask(`${at}/screenshot`), "base64"),
      close: async () => {
        await ask(at, undefined, "DELETE").catch(() => undefined);
        await end();
      },
    };
  } catch (error) {
    await end();
    throw error;
  }
}
