/**
 * A page in chromium without Playwright, over the DevTools protocol. Playwright has the browser report every WebSocket message
 * with its contents, which takes two cores some 20 ms a prefix; here the browser reports nothing unasked. The page's functions
 * have the names of Playwright's, so that the harness can use either.
 */

import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { CHROMIUM_FLAGS, TIMEOUT_MS, findBrowser } from "./harness.mjs";

export async function openQuietPage(url, { width, height, script }) {
  const browser = findBrowser();
  const profile = mkdtempSync(join(tmpdir(), "isopeel-chromium-"));
  const flags = [...CHROMIUM_FLAGS, "--headless=new", "--remote-debugging-pipe", `--user-data-dir=${profile}`];
  const child = spawn(browser, flags, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
  // Some processes of chromium end a little later and write to the profile until then.
  const ended = new Promise((done) => child.on("exit", done)).then(() => rmSync(profile, { recursive: true, force: true, maxRetries: 10 }));

  // Messages in both directions are JSON, each followed by a zero byte.
  const waiting = new Map();
  let last = 0;
  let rest = "";
  // When chromium has ended, `ended` says so.
  child.stdio[3].on("error", () => undefined);
  child.stdio[4].setEncoding("utf8");
  child.stdio[4].on("data", (data) => {
    const messages = (rest + data).split("\0");
    rest = messages.pop();
    for (const { id, result, error } of messages.map((message) => JSON.parse(message))) {
      if (id === undefined) continue;
      const { done, failed } = waiting.get(id);
      waiting.delete(id);
      if (error === undefined) done(result);
      else failed(new Error(`chromium: ${error.message}`));
    }
  });
  const send = (method, params = {}, sessionId = undefined) => {
    const answer = new Promise((done, failed) => {
      last += 1;
      waiting.set(last, { done, failed });
      child.stdio[3].write(`${JSON.stringify({ id: last, method, params, sessionId })}\0`);
    });
    const gone = ended.then(() => {
      throw new Error("chromium ended before it replied");
    });
    return Promise.race([answer, gone]);
  };

  const { targetId } = await send("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true });
  const ask = (method, params) => send(method, params, sessionId);
  await ask("Page.enable");
  await ask("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile: false });
  await ask("Emulation.setEmulatedMedia", { features: [{ name: "prefers-color-scheme", value: "dark" }] });
  await ask("Page.addScriptToEvaluateOnNewDocument", { source: script });
  await ask("Page.navigate", { url });

  /** Calls a function in the page. */
  const evaluate = async (body, argument) => {
    const expression = `(${body})(${JSON.stringify(argument)})`;
    const answer = await ask("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
    if (answer.exceptionDetails !== undefined) throw new Error(answer.exceptionDetails.exception?.description);
    return answer.result.value;
  };
  return {
    evaluate,
    /** Waits until a function in the page returns something. */
    waitForFunction: async (body, argument, { polling }) => {
      for (const began = Date.now(); Date.now() - began < TIMEOUT_MS; ) {
        const value = await evaluate(body, argument);
        if (value) return { jsonValue: () => value, dispose: () => undefined };
        await new Promise((done) => setTimeout(done, polling));
      }
      throw new Error(`not true within ${TIMEOUT_MS / 1000} s: ${body}`);
    },
    press: async (key, virtualKey) => {
      const event = { key, code: key, windowsVirtualKeyCode: virtualKey };
      await ask("Input.dispatchKeyEvent", { type: "rawKeyDown", ...event });
      await ask("Input.dispatchKeyEvent", { type: "keyUp", ...event });
    },
    close: async () => {
      // Chromium may end before it replies.
      await send("Browser.close").catch(() => undefined);
      await ended;
    },
  };
}
