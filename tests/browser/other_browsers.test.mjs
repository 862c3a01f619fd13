/** The viewer in Firefox ESR and WebKitGTK: it opens, its surface is seen, and an edit changes it; or it says why it cannot draw. */

import assert from "node:assert/strict";
import { mkdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { PNG } from "pngjs";
import { ARTEFACTS, difference, MORE, TIMEOUT_MS } from "./harness.mjs";
import { missing, openFirefox, openWebKit } from "./other_browsers.mjs";
import { setUp } from "./setup.mjs";

const at = setUp(undefined, { demo: true });

/** Asks until the answer is something. */
async function until(browser, expression) {
  const end = Date.now() + TIMEOUT_MS;
  for (;;) {
    const found = await browser.evaluate(expression);
    if (found) return found;
    if (Date.now() > end) throw new Error(`waited for ${expression}; status: ${JSON.stringify(await browser.evaluate("window.isopeel?.status"))}`);
    await new Promise((later) => setTimeout(later, 100));
  }
}

/** Surface and edit, by pixels. */
async function look(browser, name) {
  const picture = async () => {
    // The frame that was rendered last is on screen.
    await browser.evaluate("new Promise((seen) => requestAnimationFrame(() => requestAnimationFrame(() => seen(true))))");
    const bytes = await browser.screenshot();
    mkdirSync(ARTEFACTS, { recursive: true });
    writeFileSync(join(ARTEFACTS, `${name}.png`), bytes);
    return PNG.sync.read(bytes);
  };
  const { triangles, generation } = await until(browser, "window.isopeel?.status.settled && window.isopeel.status");
  assert.ok(triangles > 10_000, `${triangles} triangles`);
  const surface = await picture();
  await browser.evaluate('(document.querySelector(".viewport canvas").style.opacity = "0")');
  const share = difference(surface, await picture());
  assert.ok(share > 0.1, `${(100 * share).toFixed(1)} % of the page is surface`);
  await browser.evaluate('(document.querySelector(".viewport canvas").style.opacity = "")');
  const key = 'new KeyboardEvent("keydown", { key: "PageUp", bubbles: true, cancelable: true })';
  await browser.evaluate(`document.querySelector('[role=slider][aria-label="Isovalue"]').dispatchEvent(${key})`);
  await until(browser, `window.isopeel.status.settled && window.isopeel.status.generation > ${generation}`);
  const changed = difference(surface, await picture());
  assert.ok(changed > 0.01, `${(100 * changed).toFixed(2)} % of the page changed`);
  assert.deepEqual(await browser.evaluate("window.isopeel.status.messages"), []);
  // The demo's notice is long.
  const height = await browser.evaluate('document.querySelector(".notice").getBoundingClientRect().height');
  assert.ok(height > 20 && height < 45, `${height} pixels of two lines`);
}

for (const [name, open, absent] of [["Firefox", openFirefox, missing.firefox], ["WebKitGTK", openWebKit, missing.webkit]]) {
  const skip = MORE.skip || (absent.length > 0 && `there is no ${absent.join(", ")}`);
  test(`${name} shows the demo's surface, and what an edit makes of it`, { skip, timeout: 4 * TIMEOUT_MS }, async (context) => {
    const browser = await open();
    try {
      // The tour comes once.
      await browser.goto(`${at.server.url}/readyz`);
      await browser.evaluate('localStorage.setItem("isopeel.tour", "seen")');
      await browser.goto(`${at.server.url}/#volume=mni152`);
      const hasWebGl = await browser.evaluate('document.createElement("canvas").getContext("webgl2") !== null');
      if (hasWebGl) {
        await look(browser, name);
      } else {
        context.diagnostic(`${name} has no WebGL 2 here`);
        assert.match(await until(browser, "document.body.innerText"), /isopeel cannot draw here/);
      }
      assert.deepEqual(browser.faults, []);
    } finally {
      await browser.close();
    }
  });
}
