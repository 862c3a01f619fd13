/** Takes the screenshot in README, of the embedded demo volume: `node screenshot.mjs [--light]`. */

import { mkdirSync } from "node:fs";
import { resolve } from "node:path";
import { CHROMIUM_FLAGS, openPage, rested, startBrowser, startServer } from "./harness.mjs";

const IMAGES = resolve(import.meta.dirname, "../../docs/images");
/** A part that matters, and the rest with few triangles. */
const LINK = "#v=1&volume=mni152&triangles=20000&tf=0,0,3f6f8c;1,0.1,7d2f35&roi=53.7,-26.7,33.5,23,0.95&color=importance&map=ylor&wire=1";
const light = process.argv.includes("--light");

mkdirSync(IMAGES, { recursive: true });
const server = await startServer([], { demo: true });
const browser = await startBrowser(CHROMIUM_FLAGS);
try {
  const { page, faults } = await openPage(browser, `${server.url}/${LINK}`, {
    viewport: { width: 1440, height: 960 },
    colorScheme: light ? "light" : "dark",
  });
  const now = await rested(page);
  if (now.triangles === 0 || faults.length > 0) throw new Error(`no picture to take: ${faults.join("; ")}`);
  const path = resolve(IMAGES, light ? "viewer-light.png" : "viewer.png");
  await page.screenshot({ path });
  console.log(`${path}: ${now.triangles} triangles of ${now.statistics.fullTriangles}`);
} finally {
  await browser.close();
  await server.stop();
}
