/**
 * Makes the pictures of docs/gallery.md from the links that stand below them: `node gallery.mjs [NAME...]`. Needs ct-head.nrrd and
 * ocean_atlas_subset.nc in the folder that ISOPEEL_DATA names; the other volumes come with the program, or are made.
 */

import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { writeOcean } from "./ocean.mjs";
import { CHROMIUM_FLAGS, openPage, rested, startBrowser, startServer, writeVolume } from "./harness.mjs";

const DOCS = resolve(import.meta.dirname, "../../docs");
const IMAGES = join(DOCS, "images/gallery");
const SIZE = { width: 900, height: 600 };
const LARGEST = 150_000;
const WAVES = 192;

const data = process.env.ISOPEEL_DATA;
if (data === undefined) throw new Error("no ISOPEEL_DATA, expected the folder of ct-head.nrrd and ocean_atlas_subset.nc");

/** Names and links: a picture, and the text of a link in the next line of code. */
const entries = [...readFileSync(join(DOCS, "gallery.md"), "utf8").matchAll(/\(images\/gallery\/([\w-]+)\.webp\)\s+`(#v=1&[^`]+)`/g)].map(([, name, link]) => ({ name, link }));
const wanted = process.argv.slice(2);
const chosen = entries.filter(({ name }) => wanted.length === 0 || wanted.includes(name));
if (chosen.length === 0) throw new Error(`docs/gallery.md has none of ${wanted.join(", ")}`);

/** Runs in a page around the viewer: asks it for an image, as another page could (docs/embedding.md), and makes it small. */
async function takeImage(largest) {
  const frame = document.querySelector("iframe").contentWindow;
  const { ok, value, error } = await new Promise((found) => {
    addEventListener("message", ({ data }) => data?.type === "reply" && found(data), { once: false });
    frame.postMessage({ isopeel: 1, id: 1, type: "image", scale: 1 }, location.origin);
  });
  if (!ok) throw new Error(error);
  const picture = await createImageBitmap(value);
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  canvas.getContext("2d").drawImage(picture, 0, 0);
  for (let quality = 0.9; quality > 0.3; quality -= 0.05) {
    const blob = await canvas.convertToBlob({ type: "image/webp", quality });
    if (blob.size <= largest) return [...new Uint8Array(await blob.arrayBuffer())];
  }
  throw new Error(`more than ${largest} bytes at any quality`);
}

const folder = mkdtempSync(join(tmpdir(), "isopeel-gallery-"));
const browser = await startBrowser(CHROMIUM_FLAGS);
const volumes = [join(data, "ct-head.nrrd"), writeOcean(join(data, "ocean_atlas_subset.nc"), folder), writeVolume(mkdtempSync(join(folder, "waves-")), WAVES)];
const server = await startServer(volumes, { demo: true });
try {
  mkdirSync(IMAGES, { recursive: true });
  for (const { name, link } of chosen) {
    // Any page of the server's origin may speak to the frame. Its policy would let it have none.
    const { page } = await openPage(browser, `${server.url}/api/v1/volumes`, { viewport: SIZE, colorScheme: "light", bypassCSP: true });
    const box = await page.evaluateHandle(({ link, width, height }) => {
      document.body.style.margin = 0;
      document.body.innerHTML = `<iframe style="border: 0" width="${width}" height="${height}" src="/?embed${link}"></iframe>`;
      return document.querySelector("iframe");
    }, { link, ...SIZE });
    const frame = await box.contentFrame();
    const now = await rested(frame);
    if (link.includes("color=error")) await frame.locator(".scene-colors").waitFor();
    const bytes = await page.evaluate(takeImage, LARGEST);
    writeFileSync(join(IMAGES, `${name}.webp`), Uint8Array.from(bytes));
    console.log(`${name}: ${now.triangles} triangles of ${now.statistics.fullTriangles}, ${Math.round(bytes.length / 1000)} kB`);
    await page.close();
  }
} finally {
  await browser.close();
  await server.stop();
  rmSync(folder, { recursive: true });
}
