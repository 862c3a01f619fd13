/**
 * What the page costs beside a plain one: `node bench_page.mjs [--seconds S] [--edits N] [--rounds N] [--json]`.
 *
 * Server, headless chromium and software rendering on one machine:
 *
 * - bytes of the page's first load and of what it loads on demand, compressed as the server's responses may be;
 * - from navigation to the first frame of a surface, the demo volume, second load;
 * - frames per second while the pointer orbits some 200,000 triangles, beside a page of three.js alone with the same mesh, in turns;
 * - the heap after many edits beside that after few, both after a collection; also without the machine code that the browser makes of
 *   functions as they are called more often, which is most of what grows.
 */

import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { extname, join, resolve } from "node:path";
import { parseArgs } from "node:util";
import { gzipSync } from "node:zlib";
import { BINARY, CHROMIUM_FLAGS, openPage, rested, settled, startBrowser, startServer, writeVolume } from "./harness.mjs";

const { values: options } = parseArgs({
  options: {
    seconds: { type: "string", default: "6" },
    edits: { type: "string", default: "300" },
    rounds: { type: "string", default: "3" },
    json: { type: "boolean" },
  },
});
const [SECONDS, EDITS, ROUNDS] = [Number(options.seconds), Number(options.edits), Number(options.rounds)];
/** Samples each way of the volume that opens with some 200,000 triangles. */
const SIZE = 200;
const VIEWPORT = { width: 1100, height: 760 };
const WEB = resolve(import.meta.dirname, "../../web");

const median = (numbers) => [...numbers].sort((a, b) => a - b)[Math.floor(numbers.length / 2)];

/** Bytes of the files that `index.html` names, and of all others. */
function pageBytes() {
  const dist = join(WEB, "dist");
  const html = readFileSync(join(dist, "index.html"), "utf8");
  const size = (file) => gzipSync(readFileSync(join(dist, "assets", file)), { level: 9 }).length;
  const files = readdirSync(join(dist, "assets"));
  const sum = (of) => of.reduce((bytes, file) => bytes + size(file), 0);
  return {
    first: gzipSync(html, { level: 9 }).length + sum(files.filter((file) => html.includes(file))),
    onDemand: sum(files.filter((file) => !html.includes(file))),
  };
}

/** From the second navigation to the first frame of a surface, by the page's own clock. */
async function firstFrame(browser) {
  const server = await startServer([], { demo: true });
  const context = await browser.newContext({ viewport: VIEWPORT, colorScheme: "dark" });
  try {
    const times = [];
    for (let load = 0; load <= ROUNDS; load += 1) {
      const page = await context.newPage();
      await page.goto(`${server.url}/#v=1&volume=mni152`);
      const handle = await page.waitForFunction(() => (window.isopeel?.status.generation === undefined ? false : performance.now()));
      if (load > 0) times.push(await handle.jsonValue());
      await settled(page);
      await page.close();
    }
    return times;
  } finally {
    await context.close();
    await server.stop();
  }
}

/** Moves the pointer in circles with the button held, and counts the frames of one canvas that are rendered meanwhile. */
async function orbit(page, canvas) {
  const box = await page.locator(canvas).boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.mouse.move(x, y);
  await page.mouse.down();
  const drawn = () => page.evaluate(() => window.isopeel?.status.framesDrawn ?? window.framesDrawn);
  const [before, began] = [await drawn(), performance.now()];
  while (performance.now() - began < 1000 * SECONDS) {
    const angle = (performance.now() - began) / 300;
    await page.mouse.move(x + 120 * Math.cos(angle), y + 60 * Math.sin(angle));
    // Until the frame is on its way: more moves would only wait.
    await page.evaluate(() => new Promise(requestAnimationFrame));
  }
  const frames = (await drawn()) - before;
  const seconds = (performance.now() - began) / 1000;
  await page.mouse.up();
  return frames / seconds;
}

/** The plain page: one mesh, one light, no antialiasing, as the viewer without a GPU, three.js's own controls. */
const PLAIN = `<!doctype html><meta charset="utf-8"><title>three.js alone</title>
<style>html, body, canvas { margin: 0; width: 100%; height: 100%; display: block; overflow: hidden }</style>
<script type="importmap">{"imports": {"three": "/three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { OrbitControls } from "/three/examples/jsm/controls/OrbitControls.js";
import { GLTFLoader } from "/three/examples/jsm/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setSize(innerWidth, innerHeight);
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
const { scene: mesh } = await new GLTFLoader().loadAsync("/mesh.glb");
mesh.traverse((part) => { if (part.isMesh) part.material = new THREE.MeshLambertMaterial({ color: "#d8cdb8", side: THREE.DoubleSide }); });
scene.add(mesh, new THREE.HemisphereLight("#ffffff", "#404040", 2));
const sphere = new THREE.Box3().setFromObject(mesh).getBoundingSphere(new THREE.Sphere());
const camera = new THREE.PerspectiveCamera(40, innerWidth / innerHeight, sphere.radius / 100, sphere.radius * 10);
camera.position.copy(sphere.center).add(new THREE.Vector3(1.2, 0.9, 2.6).multiplyScalar(sphere.radius));
const controls = new OrbitControls(camera, renderer.domElement);
controls.target.copy(sphere.center);
controls.update();
window.framesDrawn = 0;
let due = false;
const draw = () => { due = false; controls.update(); renderer.render(scene, camera); window.framesDrawn += 1; };
controls.addEventListener("change", () => { if (!due) requestAnimationFrame(draw); due = true; });
draw();
window.ready = true;
</script>`;

const TYPES = { ".js": "text/javascript", ".glb": "model/gltf-binary" };

/** Serves the plain page, three.js and the mesh. */
async function servePlain(mesh) {
  const server = createServer((request, response) => {
    const path = new URL(request.url, "http://localhost").pathname;
    const file = path === "/mesh.glb" ? mesh : path.startsWith("/three/") ? join(WEB, "node_modules", path) : undefined;
    const body = path === "/" ? PLAIN : file !== undefined && existsSync(file) ? readFileSync(file) : undefined;
    response.writeHead(body === undefined ? 404 : 200, { "Content-Type": TYPES[extname(path)] ?? "text/html" });
    response.end(body);
  });
  await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
  return { url: `http://127.0.0.1:${server.address().port}/`, stop: () => server.close() };
}

/** Frames per second of both pages, in turns. */
async function orbits(browser, folder) {
  const volume = writeVolume(folder, SIZE);
  const mesh = join(folder, "mesh.glb");
  const server = await startServer([volume]);
  const plain = await servePlain(mesh);
  try {
    const { page } = await openPage(browser, `${server.url}/#v=1&volume=mni152`, { viewport: VIEWPORT });
    const { statistics, edit } = await rested(page);
    const view = ["--iso", `${edit.iso}`, "--triangles", `${statistics.triangles}`];
    execFileSync(BINARY, ["extract", volume, ...view, "--output", mesh], { stdio: "ignore" });
    const other = await browser.newPage({ viewport: VIEWPORT });
    await other.goto(plain.url);
    await other.waitForFunction(() => window.ready);
    const rates = { viewer: [], plain: [], triangles: statistics.triangles };
    for (let round = 0; round < ROUNDS; round += 1) {
      await page.bringToFront();
      rates.viewer.push(await orbit(page, ".viewport canvas"));
      await other.bringToFront();
      rates.plain.push(await orbit(other, "canvas"));
    }
    return rates;
  } finally {
    plain.stop();
    await server.stop();
  }
}

/** Bytes of the page's heap after a collection, and of all in it but compiled code. */
async function heapOf(session) {
  await session.send("HeapProfiler.collectGarbage");
  const { usedSize } = await session.send("Runtime.getHeapUsage");
  const pieces = [];
  const add = ({ chunk }) => pieces.push(chunk);
  session.on("HeapProfiler.addHeapSnapshotChunk", add);
  await session.send("HeapProfiler.takeHeapSnapshot", { reportProgress: false });
  session.off("HeapProfiler.addHeapSnapshotChunk", add);
  const { snapshot, nodes } = JSON.parse(pieces.join(""));
  const { node_fields: fields, node_types: types } = snapshot.meta;
  const [type, size, code] = [fields.indexOf("type"), fields.indexOf("self_size"), types[0].indexOf("code")];
  let compiled = 0;
  for (let i = 0; i < nodes.length; i += fields.length) if (nodes[i + type] === code) compiled += nodes[i + size];
  return { all: usedSize, objects: usedSize - compiled };
}

/** Bytes of the page's heap after a tenth of the edits and after all. */
async function heaps(browser) {
  const server = await startServer([], { demo: true });
  try {
    const { page } = await openPage(browser, `${server.url}/#v=1&volume=mni152`, { viewport: VIEWPORT });
    const session = await page.context().newCDPSession(page);
    let { generation } = await settled(page);
    const at = {};
    for (let edit = 1; edit <= EDITS; edit += 1) {
      await page.locator('[role=slider][aria-label="Isovalue"]').press(edit % 20 < 10 ? "ArrowRight" : "ArrowLeft");
      ({ generation } = await settled(page, (now, before) => now.generation > before, generation));
      if (edit === EDITS / 10) at.few = await heapOf(session);
    }
    at.many = await heapOf(session);
    return at;
  } finally {
    await server.stop();
  }
}

const folder = mkdtempSync(join(tmpdir(), "isopeel-page-"));
const browser = await startBrowser(CHROMIUM_FLAGS);
try {
  const bytes = pageBytes();
  const frames = await firstFrame(browser);
  const rates = await orbits(browser, folder);
  const heap = EDITS >= 10 ? await heaps(browser) : undefined;
  if (options.json) console.log(JSON.stringify({ bytes, frames, rates, heap }));
  console.log(`first load ${(bytes.first / 1000).toFixed(0)} kB, on demand ${(bytes.onDemand / 1000).toFixed(0)} kB (gzip)`);
  console.log(`navigation to first frame, demo, second load: median ${median(frames).toFixed(0)} ms`);
  console.log(
    `orbit of ${rates.triangles} triangles: ${median(rates.viewer).toFixed(1)} frames per second, ` +
      `three.js alone ${median(rates.plain).toFixed(1)}: ratio ${(median(rates.viewer) / median(rates.plain)).toFixed(2)}`,
  );
  if (heap !== undefined) {
    const { few, many } = heap;
    console.log(
      `heap after ${EDITS} edits ÷ after ${EDITS / 10}: ${(many.all / few.all).toFixed(3)} (${(many.all / 1e6).toFixed(1)} MB), ` +
        `without compiled code ${(many.objects / few.objects).toFixed(3)} (${(many.objects / 1e6).toFixed(1)} MB)`,
    );
  }
} finally {
  await browser.close();
  rmSync(folder, { recursive: true });
}
