/** Takes the screenshot in README, of the embedded demo volume: `node screenshot.mjs [--light]`. */

import { mkdirSync } from "node:fs";
import { resolve } from "node:path";
import { openPage, rested, startBrowser, startServer } from "./harness.mjs";

const IMAGES = resolve(import.meta.dirname, "../../docs/images");
const light = process.argv.includes("--light");

mkdirSync(IMAGES, { recursive: true });
const server = await startServer([], { demo: true });
const browser = await startBrowser();
try {
  const { page, faults } = await openPage(browser, server.url, {
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
