/** What is taken along of several surfaces: all of them in one GLB, and an image that says which is which. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import validator from "gltf-validator";
import { PNG } from "pngjs";
import { MORE, openPage, rested, TIMEOUT_MS } from "./harness.mjs";
import { setUp } from "./setup.mjs";

const at = setUp();

/** Two balls in each other, the outer one orange and translucent. */
const TWO = "#volume=bumpy&iso=7&triangles=4000&s2.iso=0&s2.tint=e08a5b&s2.opacity=0.35";

async function saved(page, act) {
  const [download] = await Promise.all([page.waitForEvent("download"), act()]);
  return { name: download.suggestedFilename(), bytes: readFileSync(await download.path()) };
}

/** The JSON of a GLB. */
const gltfOf = (bytes) => JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12)).toString());

test("all visible surfaces are one valid GLB, in their colours", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page, faults } = await openPage(at.browser, `${at.server.url}/${TWO}`);
  const { triangles } = await rested(page);
  await page.getByRole("button", { name: "Share and export" }).click();
  const { name, bytes } = await saved(page, () => page.getByRole("menuitem", { name: "GLB of both visible surfaces" }).click());
  assert.equal(name, "bumpy-surfaces.glb");
  const { issues, info } = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 20 });
  assert.deepEqual([issues.numErrors, issues.numWarnings], [0, 0], JSON.stringify(issues.messages, null, 1));
  assert.ok(Math.abs(info.totalTriangleCount - triangles) < 0.02 * triangles, `${info.totalTriangleCount} of ${triangles} triangles`);
  const { nodes, materials } = gltfOf(bytes);
  assert.deepEqual(nodes.map((node) => node.name), ["7", "0"]);
  assert.deepEqual(materials.map(({ alphaMode }) => alphaMode), [undefined, "BLEND"]);
  const [red, green, blue, opacity] = materials[1].pbrMetallicRoughness.baseColorFactor;
  assert.ok(red > green && green > blue && opacity === 0.35, JSON.stringify(materials[1]));

  // One that is hidden is none of them.
  await page.getByRole("button", { name: "Hide surface 1" }).click();
  await page.getByRole("button", { name: "Share and export" }).click();
  await page.getByRole("menuitem", { name: "Copy link" }).waitFor();
  assert.equal(await page.getByRole("menuitem", { name: /all/ }).count(), 0);
  assert.deepEqual(faults, []);
  await page.close();
});

test("an image has the colour and the isovalue of each surface, where it is asked for", { ...MORE, timeout: 4 * TIMEOUT_MS }, async () => {
  const { page } = await openPage(at.browser, `${at.server.url}/${TWO}&background=white&s2.opacity=1`);
  await rested(page);
  await page.getByRole("button", { name: "Export", exact: true }).click();
  const image = async () => PNG.sync.read((await saved(page, () => page.getByRole("button", { name: "Save PNG" }).click())).bytes);
  // The second swatch, of a picture with two pixels for one.
  const colorIn = ({ width, data }) => [...data.subarray(4 * (2 * 46 * width + 2 * 27), 4 * (2 * 46 * width + 2 * 27) + 3)];
  const near = (color, [r, g, b]) => Math.max(Math.abs(color[0] - r), Math.abs(color[1] - g), Math.abs(color[2] - b)) < 6;
  const signed = colorIn(await image());
  assert.ok(near(signed, [0xe0, 0x8a, 0x5b]), `${signed}`);
  await page.getByText("Isovalues", { exact: true }).click();
  const plain = colorIn(await image());
  assert.ok(near(plain, [255, 255, 255]), `${plain}`);
  await page.close();
});
