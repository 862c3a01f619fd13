/**
 * A page in chromium that nobody listens in on. Playwright has the browser report every frame of a socket, contents and all,
 * which on two cores costs as much as drawing a picture; this speaks only when it asks for something.
 */

import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { CHROMIUM, FLAGS, PATIENCE_MS } from "./harness.mjs";

export async function openQuietPage(url, { width, height, script }) {
  const profile = mkdtempSync(join(tmpdir(), "isopeel-chromium-"));
  const flags = [...FLAGS, "--headless=new", "--remote-debugging-pipe", `--user-data-dir=${profile}`, "--force-dark-mode"];
  const child = spawn(CHROMIUM, flags, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
  const ended = new Promise((done) => child.on("exit", done));

  // Messages both ways are JSON, each with a zero byte behind it.
  const waiting = new Map();
  let last = 0;
  let rest = "";
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
  const send = (method, params = {}, sessionId = undefined) =>
    new Promise((done, failed) => {
      last += 1;
      waiting.set(last, { done, failed });
      child.stdio[3].write(`${JSON.stringify({ id: last, method, params, sessionId })}\0`);
    });

  const { targetId } = await send("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true });
  const ask = (method, params) => send(method, params, sessionId);
  await ask("Page.enable");
  await ask("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile: false });
  await ask("Page.addScriptToEvaluateOnNewDocument", { source: script });
  await ask("Page.navigate", { url });

  /** Calls a function in the page. */
  const evaluate = async (body, ...args) => {
    const expression = `(${body})(...${JSON.stringify(args)})`;
    const answer = await ask("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
    if (answer.exceptionDetails !== undefined) throw new Error(answer.exceptionDetails.exception?.description);
    return answer.result.value;
  };
  return {
    evaluate,
    /** Waits until a function in the page answers something, and answers that. */
    until: async (body, ...args) => {
      for (const began = Date.now(); Date.now() - began < PATIENCE_MS; ) {
        const value = await evaluate(body, ...args);
        if (value) return value;
        await new Promise((done) => setTimeout(done, 50));
      }
      throw new Error(`in ${PATIENCE_MS / 1000} s it was never true: ${body}`);
    },
    press: async (key, virtualKey) => {
      const event = { key, code: key, windowsVirtualKeyCode: virtualKey };
      await ask("Input.dispatchKeyEvent", { type: "rawKeyDown", ...event });
      await ask("Input.dispatchKeyEvent", { type: "keyUp", ...event });
    },
    close: async () => {
      await send("Browser.close");
      await ended;
      // Some of its processes end a little later.
      rmSync(profile, { recursive: true, force: true, maxRetries: 10 });
    },
  };
}
