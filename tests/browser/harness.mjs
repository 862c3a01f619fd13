/** What the browser tests share: server, a small volume, chromium, and comparing screenshots. */

import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { PNG } from "pngjs";

const HERE = import.meta.dirname;
export const BINARY = resolve(HERE, process.env.ISOPEEL_BINARY ?? "../../target/release/isopeel");
const CHROMIUM = process.env.CHROMIUM ?? "/usr/bin/chromium";
export const ARTEFACTS = resolve(HERE, process.env.ARTEFACTS ?? "../../artefacts", "browser");

/** Of a test that `make test-browsers` runs, and `make test` does not, which has little time. */
export const MORE = { skip: process.env.BROWSER_TESTS === "all" ? false : "in make test-browsers" };

/** Software rendering, and no connections to other machines. */
export const CHROMIUM_FLAGS = [
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
];

/**
 * Flags of the tests. In the small set WebGL draws in SwiftShader, but the compositor does not: with it the graphics process takes
 * twice the time or more. In the larger set both do.
 */
const TEST_FLAGS = process.env.BROWSER_TESTS === "all" ? CHROMIUM_FLAGS : [...CHROMIUM_FLAGS, "--disable-gpu-compositing"];

/** Long, because PoCL compiles kernels at the first start. */
export const TIMEOUT_MS = 60_000;

/** A NumPy file, C order with x fastest. */
export function npy([nx, ny, nz], value) {
  const dict = `{'descr': '<f4', 'fortran_order': False, 'shape': (${nz}, ${ny}, ${nx}), }`;
  const header = dict.padEnd(Math.ceil((dict.length + 11) / 64) * 64 - 11) + "\n";
  const bytes = Buffer.alloc(10 + header.length + 4 * nx * ny * nz);
  bytes.write("\x93NUMPY\x01\x00", 0, "latin1");
  bytes.writeUInt16LE(header.length, 8);
  bytes.write(header, 10, "latin1");
  let at = 10 + header.length;
  for (let z = 0; z < nz; z += 1)
    for (let y = 0; y < ny; y += 1) for (let x = 0; x < nx; x += 1) at = bytes.writeFloatLE(value(x, y, z), at);
  return bytes;
}

const DIMS = [50, 47, 44];

/** A ball with bumps on one half, so that a cut keeps that half and decimates the other. */
function ball(x, y, z) {
  const [u, v, w] = [x - DIMS[0] / 2, y - DIMS[1] / 2, z - DIMS[2] / 2];
  const bumps = u > 0 ? 1.4 * Math.sin(0.8 * u) * Math.sin(0.8 * v) * Math.sin(0.8 * w) : 0;
  return 15 + bumps - Math.hypot(u, v, w);
}

/** A fresh folder with a volume of two fields. */
export function makeVolume() {
  const folder = join(mkdtempSync(join(tmpdir(), "isopeel-browser-")), "bumpy");
  mkdirSync(folder);
  writeFileSync(join(folder, "depth.npy"), npy(DIMS, ball));
  writeFileSync(join(folder, "height.npy"), npy(DIMS, (_x, _y, z) => z));
  return { path: folder, remove: () => rmSync(resolve(folder, ".."), { recursive: true }) };
}

/** Middle and radius of the balls of `makeBalls`. */
const BALLS = [
  [[16, 20, 20], 10],
  [[44, 20, 20], 10],
  [[30, 20, 36], 3],
];

/** A fresh folder with a volume of three balls that nothing connects. */
export function makeBalls() {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-"));
  const path = join(folder, "balls.npy");
  const depth = (...at) => Math.max(...BALLS.map(([middle, radius]) => radius - Math.hypot(...at.map((x, axis) => x - middle[axis]))));
  writeFileSync(path, npy([60, 40, 42], depth));
  return { path, remove: () => rmSync(folder, { recursive: true }) };
}

/** A fresh folder of numbered files, time steps of a growing ball; `add` writes a further one. */
export function makeSteps(count) {
  const folder = mkdtempSync(join(tmpdir(), "isopeel-browser-"));
  const path = join(folder, "growing");
  mkdirSync(path);
  const add = (step) => writeFileSync(join(path, `growing_${10 + step}.npy`), npy([40, 40, 40], (...at) => 8 + step - Math.hypot(...at.map((x) => x - 20))));
  for (let step = 0; step < count; step += 1) add(step);
  return { path, add, remove: () => rmSync(folder, { recursive: true }) };
}

/** Writes a volume of `size`³ samples with a surface that fills it into `folder`, and returns its file. */
export function writeVolume(folder, size) {
  const options = ["--volume", "sin", "--size", `${size}`, "--type", "u8", "--case", "load", "--repeats", "1", "--save", folder];
  execFileSync(BINARY, ["bench", ...options], { stdio: "ignore", timeout: TIMEOUT_MS });
  return join(folder, readdirSync(folder).find((name) => name.endsWith(".nrrd")));
}

/**
 * Starts the server and waits for the address it prints.
 *
 * @param options further options; without `--no-auth` where they say which token is asked for
 */
export async function startServer(paths, { port = 0, demo = false, options = ["--no-auth"] } = {}) {
  if (!existsSync(BINARY)) throw new Error(`no server at ${BINARY}: build it, or name it in ISOPEEL_BINARY`);
  const child = spawn(BINARY, ["serve", ...paths, demo ? "--demo" : "--no-demo", "--listen", `127.0.0.1:${port}`, ...options]);
  let log = "";
  child.stderr.on("data", (data) => (log += data));
  const [url, secret] = await new Promise((found, failed) => {
    let out = "";
    child.stdout.on("data", (data) => {
      out += data;
      const match = /(http:\/\/\S+:\d+)(\S*)\n/.exec(out);
      if (match !== null) found(match.slice(1));
    });
    child.on("error", failed);
    child.on("exit", (code, signal) => failed(new Error(`the server ended (${code ?? signal}) before it listened:\n${log}`)));
    setTimeout(() => failed(new Error(`the server printed no address:\n${log}`)), TIMEOUT_MS).unref();
  });
  return {
    url,
    /** What follows the address, where a token is asked for. */
    secret,
    port: Number(new URL(url).port),
    log: () => log,
    stop: (signal = "SIGTERM") =>
      new Promise((done) => {
        if (child.exitCode !== null || child.signalCode !== null) return done();
        child.on("exit", done);
        child.kill(signal);
      }),
  };
}

/** Where chromium is. */
export function findBrowser() {
  if (!existsSync(CHROMIUM)) throw new Error(`no browser at ${CHROMIUM}: apt-get install chromium, or name it in CHROMIUM`);
  return CHROMIUM;
}

/** Starts chromium with the flags of the tests, or with others. */
export async function startBrowser(args = TEST_FLAGS) {
  // Loaded here, because a file whose tests are all skipped does not need it.
  const { chromium } = await import("playwright-core");
  const browser = await chromium.launch({ executablePath: findBrowser(), args });
  const newPage = browser.newPage.bind(browser);
  browser.newPage = async (options) => {
    const page = await newPage(options);
    waitFromOutside(page);
    return page;
  };
  return browser;
}

/** Playwright's own evaluates text in the page while it waits, which the page's policy forbids. This one asks again from outside. */
function waitFromOutside(page) {
  page.waitForFunction = async (body, argument, { polling = 50, timeout = TIMEOUT_MS } = {}) => {
    for (const began = Date.now(); Date.now() - began < timeout; ) {
      const value = await page.evaluate(body, argument).catch((error) => {
        // The page is on its way to another address.
        if (!/context was destroyed|navigat/i.test(error.message)) throw error;
      });
      if (value) return { jsonValue: () => value, dispose: () => undefined };
      await new Promise((done) => setTimeout(done, typeof polling === "number" ? polling : 50));
    }
    throw new Error(`not true within ${timeout / 1000} s: ${body}`);
  };
}

/**
 * A page, the errors on its console, and the messages of its WebSocket in both directions, in order.
 *
 * @param tour as somebody who has not been here before
 */
export async function openPage(browser, url, { tour = false, ...options } = {}) {
  const page = await browser.newPage({ viewport: { width: 1100, height: 760 }, colorScheme: "dark", ...options });
  page.setDefaultTimeout(TIMEOUT_MS);
  waitFromOutside(page);
  if (!tour) await skipTour(page);
  const faults = [];
  page.on("pageerror", (error) => faults.push(String(error)));
  page.on("console", (message) => {
    // The browser logs each failed connection while there is no server.
    if (message.type() === "error" && !/WebSocket connection|Failed to load resource/.test(message.text())) {
      faults.push(message.text());
    }
  });
  const messages = [];
  page.on("websocket", (socket) => {
    const record = ({ payload }) => typeof payload === "string" && messages.push(JSON.parse(payload));
    socket.on("framesent", record);
    socket.on("framereceived", record);
  });
  await page.goto(url);
  return { page, faults, messages };
}

/** The next pages are those of somebody who knows the tour. */
export const skipTour = (page) => page.addInitScript(() => localStorage.setItem("isopeel.tour", "seen"));

export const status = (page) => page.evaluate(() => window.isopeel.status);

/** Waits until the final surface is on screen and `condition` (of the status) holds; returns the status. Fails at once when the viewer reports an error. */
export async function settled(page, condition = () => true, argument = undefined) {
  try {
    const handle = await page.waitForFunction(
      ([condition, argument]) => {
        const now = window.isopeel?.status;
        if (now === undefined) return false;
        if (now.messages.length > 0) throw new Error(`the viewer says: ${now.messages.join("; ")}`);
        return now.settled && new Function(`return (${condition})`)()(now, argument) ? now : false;
      },
      [condition.toString(), argument],
      { polling: 50 },
    );
    const now = await handle.jsonValue();
    // What it refers to would stay in the page's heap.
    await handle.dispose();
    return now;
  } catch (error) {
    const now = await page.evaluate(() => window.isopeel?.status).catch(() => undefined);
    throw new Error(`${error.message.split("\n")[0]}, waiting for ${condition}; status: ${JSON.stringify(now)}`);
  }
}

/** As `settled`, and all has come that comes while the viewer rests: a better surface, and the measured error. */
export const rested = (page) =>
  settled(page, ({ surfaces }) => surfaces.length > 0 && surfaces.every(({ statistics, triangles }) => statistics.error !== null && statistics.triangles === triangles));

/** Chooses what decides how much is decimated: `Error`, `Triangles` or `β (paper)`. */
export async function decideBy(page, criterion) {
  await page.locator("details.expert").evaluate((details) => (details.open = true));
  await page.getByRole("radiogroup", { name: "Limit by" }).getByText(criterion, { exact: true }).click();
}

/** Waits until more than `framesDrawn` frames were rendered. */
export async function frameAfter(page, framesDrawn) {
  await page.waitForFunction((before) => window.isopeel.status.framesDrawn > before, framesDrawn, { polling: 50 });
}

/** Waits until damping no longer moves the camera, and the frame in full that follows a move is painted: a while without a new frame of the viewer. */
export async function cameraAtRest(page) {
  await page.evaluate(async () => {
    let drawn = -1;
    let since = performance.now();
    for (let still = 0; still < 5 || performance.now() - since < 300; ) {
      await new Promise(requestAnimationFrame);
      const { framesDrawn } = window.isopeel.status;
      if (framesDrawn !== drawn) since = performance.now();
      still = framesDrawn === drawn ? still + 1 : 0;
      drawn = framesDrawn;
    }
  });
}

/** The pixels of the picture, without what lies over it. A style that Playwright adds would break the page's policy; a sheet of the page does not. */
export async function picture(page) {
  await page.evaluate(() => {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(".banner, .toasts, .notice, .hint, .display-legend, .tour, .scene-overlay, .field-legend { visibility: hidden !important }");
    document.adoptedStyleSheets = [sheet];
  });
  const pixels = await page.locator(".viewport canvas").screenshot();
  await page.evaluate(() => (document.adoptedStyleSheets = []));
  return PNG.sync.read(pixels);
}

/** As `picture`, once two in a row are equal: a busy machine draws frames of lower quality first. */
export async function stillPicture(page) {
  let last = await picture(page);
  for (let tries = 0; tries < 20; tries++) {
    await page.waitForTimeout(400);
    const next = await picture(page);
    if (difference(last, next, 0) === 0) return next;
    last = next;
  }
  throw new Error("the picture does not come to rest");
}

/** Pixels whose colour differs by more than `tolerance` in some channel, as a share of all. */
export function difference(a, b, tolerance = 12) {
  if (a.width !== b.width || a.height !== b.height) throw new Error("pictures of different sizes");
  let different = 0;
  for (let i = 0; i < a.data.length; i += 4) {
    const apart = Math.max(Math.abs(a.data[i] - b.data[i]), Math.abs(a.data[i + 1] - b.data[i + 1]), Math.abs(a.data[i + 2] - b.data[i + 2]));
    if (apart > tolerance) different += 1;
  }
  return different / (a.width * a.height);
}

/** Saves a picture of the page for people to look at, in `make test-browsers` or if ARTEFACTS names a folder. */
export async function saveScreenshot(page, name) {
  if (process.env.BROWSER_TESTS !== "all" && process.env.ARTEFACTS === undefined) return;
  mkdirSync(ARTEFACTS, { recursive: true });
  await page.screenshot({ path: join(ARTEFACTS, `${name}.png`) });
}

/** Drags the slider with this label to a position, 0 to 1, with the mouse. */
export async function dragSlider(page, label, to) {
  const slider = page.getByRole("slider", { name: label, exact: true }).and(page.locator("input"));
  // Scrolls there, and waits until cards above it no longer grow.
  await slider.hover();
  const box = await slider.boundingBox();
  const thumb = 16;
  const x = (position) => box.x + thumb / 2 + position * (box.width - thumb);
  const from = Number(await slider.inputValue()) / 1000;
  await page.mouse.move(x(from), box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(x((from + to) / 2), box.y + box.height / 2, { steps: 8 });
  await page.mouse.move(to <= 0 ? box.x - 20 : to >= 1 ? box.x + box.width + 20 : x(to), box.y + box.height / 2, { steps: 8 });
  await page.mouse.up();
}
