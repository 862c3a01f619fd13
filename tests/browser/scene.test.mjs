/** Pixels of the scene alone, with spheres whose picture is known: a page of web/test/bench, which Vite serves. */

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { resolve } from "node:path";
import { after, before, beforeEach, afterEach, describe, test } from "node:test";
import { PNG } from "pngjs";
import { MORE, startBrowser, TIMEOUT_MS } from "./harness.mjs";

const WEB = resolve(import.meta.dirname, "../../web");
const SIZE = { width: 400, height: 300 };

let vite;
let url;
let browser;
let page;
let faults;

/** Starts Vite on a free port and waits for the address it prints. */
async function startVite() {
  const child = spawn(process.execPath, ["node_modules/vite/bin/vite.js", "--host", "127.0.0.1"], { cwd: WEB, env: { ...process.env, NO_COLOR: "1" } });
  const address = await new Promise((found, failed) => {
    let out = "";
    const read = (data) => {
      out += data;
      const match = /http:\/\/127\.0\.0\.1:\d+/.exec(out);
      if (match !== null) found(match[0]);
    };
    child.stdout.on("data", read);
    child.stderr.on("data", read);
    child.on("exit", (code) => failed(new Error(`vite ended (${code}) before it listened:\n${out}`)));
    setTimeout(() => failed(new Error(`vite printed no address:\n${out}`)), TIMEOUT_MS).unref();
  });
  return { child, address };
}

before(async () => {
  ({ child: vite, address: url } = await startVite());
  browser = await startBrowser();
  // Vite prepares dependencies when a page asks for them first, and has it load again.
  const first = await browser.newPage();
  await first.goto(`${url}/test/bench/`);
  await first.waitForFunction(() => window.bench !== undefined, undefined, { timeout: TIMEOUT_MS });
  await first.close();
});

after(async () => {
  await browser?.close();
  vite?.kill();
});

async function openBench(options = {}) {
  const opened = await browser.newPage({ viewport: SIZE, colorScheme: "light", reducedMotion: "reduce", ...options });
  opened.setDefaultTimeout(TIMEOUT_MS);
  opened.on("pageerror", (error) => faults.push(String(error)));
  opened.on("console", (message) => message.type() === "error" && !/Failed to load resource/.test(message.text()) && faults.push(message.text()));
  await opened.goto(`${url}/test/bench/`);
  await opened.waitForFunction(() => window.bench !== undefined);
  return opened;
}

beforeEach(async () => {
  faults = [];
  page = await openBench();
});

afterEach(async () => {
  assert.deepEqual(faults, [], "errors on the console");
  await page.close();
});

/** The colour of the bench's pixel at shares of its width and height. */
const pixel = (x, y) => page.evaluate(([x, y]) => window.bench.pixel(x, y), [x, y]);
const pose = (of = page) => of.evaluate(() => window.bench.scene.camera.pose);
const still = (of = page) => of.evaluate(() => window.bench.still());
const distance = ({ position, target }) => Math.hypot(...position.map((p, axis) => p - target[axis]));

function near(found, expected, tolerance, what) {
  const apart = Math.max(...expected.map((value, i) => Math.abs(value - found[i])));
  assert.ok(apart <= tolerance, `${what}: ${found.join(", ")}, expected ${expected.map((v) => v.toFixed(0)).join(", ")} ± ${tolerance}`);
}

describe("camera", { timeout: 2 * TIMEOUT_MS }, () => {
  beforeEach(async () => {
    await page.evaluate(async () => {
      await window.bench.addSphere({ radius: 10 });
      window.bench.scene.home(false);
      await window.bench.still();
    });
  });

  test("a pose is restored exactly, in a page just opened too", MORE, async () => {
    await page.evaluate(() => {
      window.bench.scene.camera.projection = "orthographic";
      window.bench.scene.camera.restore({ position: [31.25, -7.5, 12.125], target: [1.5, -2, 3.25], projection: "orthographic" });
    });
    const link = JSON.parse(JSON.stringify(await pose()));
    assert.ok(Math.max(...[31.25, -7.5, 12.125].map((p, axis) => Math.abs(p - link.position[axis]))) < 1e-9);
    const other = await openBench();
    await other.evaluate(async (link) => {
      // Before there is anything to look at, as from a link.
      window.bench.scene.camera.restore(link);
      await window.bench.addSphere({ radius: 10 });
      await window.bench.still();
    }, link);
    const found = await pose(other);
    assert.equal(found.projection, "orthographic");
    for (const part of ["position", "target"]) {
      found[part].forEach((value, axis) => assert.ok(Math.abs(value - link[part][axis]) < 1e-9, `${part}: ${found[part]}`));
    }
    await other.close();
  });

  test("zoom is bounded both ways, and home is where it began", MORE, async () => {
    const begin = await pose();
    await page.mouse.move(200, 150);
    // 0.02 and 12 radii of the box around the sphere, √3 · 10.
    for (const [wheel, bound] of [[-800, 0.3464], [800, 207.8]]) {
      for (let i = 0; i < 60; i += 1) await page.mouse.wheel(0, wheel);
      await still();
      const now = distance(await pose());
      assert.ok(Math.abs(now / bound - 1) < 0.01, `the target is ${now} away, expected ${bound}`);
    }
    const { target } = await pose();
    assert.ok(Math.max(...target.map(Math.abs)) <= 10.001, `the target ${target} has left the box`);
    await page.evaluate(() => window.bench.scene.home());
    await still();
    const end = await pose();
    end.position.forEach((p, axis) => assert.ok(Math.abs(p - begin.position[axis]) < 1e-6));
  });

  test("the wheel zooms towards the surface under the pointer and stops before it, and the scale bar is that of the surface at the centre", async () => {
    const [x, y] = [150, 120];
    const pick = (...at) => page.evaluate((at) => window.bench.scene.pick(...at), at);
    const { position: before } = await pick(x, y);
    await page.mouse.move(x, y);
    for (let i = 0; i < 12; i += 1) await page.mouse.wheel(0, -300);
    await still();
    const { position: eye, target } = await pose();
    assert.ok(Math.hypot(...eye) > 10, `the camera is at ${eye}, within the sphere`);
    assert.ok(Math.hypot(...eye) < 14, `the camera stayed at ${eye}`);
    // The same place of the surface is there still, and the camera turns around one near it.
    const { position: after } = await pick(x, y);
    assert.ok(Math.hypot(...after.map((c, axis) => c - before[axis])) < 0.05, `${before} became ${after}`);
    assert.ok(Math.hypot(...target.map((c, axis) => c - before[axis])) < 1, `the target is ${target}`);
    await page.waitForTimeout(500);
    const bar = await page.evaluate(() => {
      const element = document.querySelector(".scene-scale");
      return { text: element.textContent, pixels: element.querySelector("i").getBoundingClientRect().width };
    });
    // Two places of the surface, twenty pixels apart around the centre, have this distance.
    const [a, b] = [await pick(SIZE.width / 2 - 10, SIZE.height / 2), await pick(SIZE.width / 2 + 10, SIZE.height / 2)];
    const forward = target.map((c, axis) => (c - eye[axis]) / Math.hypot(...target.map((c, axis) => c - eye[axis])));
    const apart = a.position.map((c, axis) => c - b.position[axis]);
    const along = apart.reduce((sum, c, axis) => sum + c * forward[axis], 0);
    const across = Math.sqrt(apart.reduce((sum, c) => sum + c * c, 0) - along ** 2);
    const [length, words] = [parseFloat(bar.text), bar.text.replace(/^[\d.]+ /, "")];
    assert.equal(words, "world units at the centre");
    assert.ok(Math.abs((bar.pixels / length) * (across / 20) - 1) < 0.03, `${bar.text} has ${bar.pixels} pixels, of which 20 are ${across}`);
  });

  test("an image has a scale bar if one length is right over its middle", async () => {
    const units = (projection, distance) =>
      page.evaluate(
        ([projection, distance]) => {
          const { scene } = window.bench;
          scene.camera.restore({ position: [0, -distance, 0], target: [0, 0, 0], projection });
          return scene.snapshot({ scale: 1, transparent: true }).unitsPerPixel ?? null;
        },
        [projection, distance],
      );
    const across = 2 * Math.tan(Math.PI * (16 / 180));
    const front = (await units("perspective", 60)) / (across / SIZE.height);
    assert.ok(front > 50 && front < 50 * 1.05, `the bar is that of depth ${front}, the sphere begins at 50`);
    assert.ok(Math.abs((await units("orthographic", 60)) / ((across * 60) / SIZE.height) - 1) < 1e-6);
    // A small sphere before it is at less than nine tenths of the distance.
    await page.evaluate(() => window.bench.addSphere({ radius: 1, center: [0, -20, 0] }));
    assert.equal(await units("perspective", 60), null);
  });

  test("keys turn, move and zoom while the canvas has the focus, and not else", MORE, async () => {
    const begin = await pose();
    await page.keyboard.press("ArrowLeft");
    await still();
    assert.deepEqual(await pose(), begin);
    await page.locator("canvas").focus();
    const changes = {};
    for (const key of ["ArrowLeft", "ArrowUp", "Shift+ArrowRight", "+", "-"]) {
      const before = await pose();
      await page.keyboard.press(key);
      await still();
      changes[key] = [before, await pose()];
    }
    for (const key of ["ArrowLeft", "ArrowUp"]) {
      const [before, now] = changes[key];
      assert.ok(Math.abs(distance(now) - distance(before)) < 1e-6, `${key} keeps the distance`);
      assert.ok(Math.hypot(...now.position.map((p, i) => p - before.position[i])) > 1, `${key} turns`);
    }
    assert.ok(changes["ArrowUp"][1].position[2] > changes["ArrowUp"][0].position[2], "up looks from higher up");
    assert.ok(Math.hypot(...changes["Shift+ArrowRight"][1].target.map((p, i) => p - changes["Shift+ArrowRight"][0].target[i])) > 0.5, "shift moves");
    assert.ok(distance(changes["+"][1]) < 0.9 * distance(changes["+"][0]));
    assert.ok(distance(changes["-"][1]) > 1.1 * distance(changes["-"][0]));
  });

  test("moves are animated, but not for who asked for less motion", MORE, async () => {
    const moving = await openBench({ reducedMotion: "no-preference" });
    for (const [of, max, min] of [[page, 3, 1], [moving, 1000, 4]]) {
      await of.evaluate(async () => {
        await window.bench.addSphere({ radius: 10 });
        window.bench.scene.home(false);
        await window.bench.still();
      });
      const frames = await of.evaluate(async () => {
        const { scene, still } = window.bench;
        const before = scene.framesRendered;
        scene.view("+y");
        await still();
        return scene.framesRendered - before;
      });
      assert.ok(frames >= min && frames <= max, `${frames} frames`);
      const { position, target } = await pose(of);
      assert.ok(Math.abs(position[0] - target[0]) < 1e-3 && position[1] > 20, `${position}`);
    }
    await moving.close();
  });

  test("both projections show the surface in the same size, and a frame is drawn only when something changes", MORE, async () => {
    const widths = {};
    for (const projection of ["perspective", "orthographic"]) {
      widths[projection] = await page.evaluate(async (projection) => {
        const { scene, still } = window.bench;
        scene.camera.projection = projection;
        await still();
        const { width, height, pixels } = scene.snapshot({ scale: 1, transparent: true });
        const row = Math.floor(height / 2);
        let covered = 0;
        for (let x = 0; x < width; x += 1) if (pixels[4 * (row * width + x) + 3] > 127) covered += 1;
        return covered;
      }, projection);
    }
    // The silhouette of a sphere lies nearer than its middle, so a perspective view shows it a little larger.
    const ratio = widths.perspective / widths.orthographic;
    assert.ok(ratio > 1 && ratio < 1.08, `${JSON.stringify(widths)}`);
    await still();
    const idle = await page.evaluate(async () => {
      const before = window.bench.scene.framesRendered;
      for (let i = 0; i < 20; i += 1) await new Promise(requestAnimationFrame);
      return window.bench.scene.framesRendered - before;
    });
    assert.equal(idle, 0);
  });
});

describe("look", { timeout: 2 * TIMEOUT_MS }, () => {
  test("materials, flat triangles, levels and backgrounds look different, unlit is the colour itself", MORE, async () => {
    await page.evaluate(async () => {
      await window.bench.addSphere({ radius: 10 });
      window.bench.scene.home(false);
      window.bench.scene.setLook({ occlusion: false });
    });
    const at = async (look) => {
      await page.evaluate((look) => window.bench.scene.setLook(look), look);
      return pixel(0.45, 0.4);
    };
    const seen = {};
    for (const material of ["ivory", "clay", "tissue", "metal"]) seen[material] = (await at({ material })).join();
    assert.equal(new Set(Object.values(seen)).size, 4, JSON.stringify(seen));
    near(await at({ material: "unlit" }), [0xd9, 0xd9, 0xd9, 255], 2, "unlit");
    near(await at({ colorMode: "level" }), [0xa3, 0x26, 0x0f, 255], 2, "level 0");
    await page.evaluate(() => window.bench.scene.colors.setAlpha(0));
    // The table goes from red at the south pole to blue at the north pole.
    const [red, , blue] = await at({ colorMode: "transfer" });
    assert.ok(red > 60 && blue > 100 && red < 250 && blue < 250, `${red} ${blue}`);
    await page.evaluate(() => window.bench.scene.setLook({ colorMode: "material", background: "black" }));
    const corner = await page.evaluate(() => [...window.bench.scene.snapshot({ scale: 1, transparent: false }).pixels.subarray(0, 4)]);
    assert.deepEqual(corner, [0, 0, 0, 255]);
    assert.equal((await pixel(0.01, 0.01))[3], 0, "transparent when asked for");
  });

  test("flat triangles have one light each", MORE, async () => {
    const shades = async (flat) =>
      page.evaluate(async (flat) => {
        const { scene, addSphere } = window.bench;
        if (scene.regionCount === 0) await addSphere({ radius: 10, segments: 12 });
        scene.home(false);
        scene.setLook({ flat, occlusion: false });
        const { width, height, pixels } = scene.snapshot({ scale: 1, transparent: true });
        const found = new Set();
        for (let i = 0; i < 4 * width * height; i += 4) if (pixels[i + 3] === 255) found.add(pixels[i] * 65536 + pixels[i + 1] * 256 + pixels[i + 2]);
        return found.size;
      }, flat);
    const [smooth, flat] = [await shades(false), await shades(true)];
    // The edges between triangles are averages of two.
    assert.ok(flat < 0.8 * smooth, `${flat} colours flat, ${smooth} smooth`);
  });

  test("occlusion darkens a crevice and no free surface, silhouettes draw its outline", MORE, async () => {
    const found = await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      // Two spheres that meet at x = 0, seen from the side.
      await addSphere({ radius: 10, center: [-9, 0, 0] });
      await addSphere({ radius: 10, center: [9, 0, 0] });
      scene.view("-y", false);
      const sums = (look) => {
        scene.setLook({ occlusion: false, silhouettes: false, ...look });
        const { width, height, pixels } = scene.snapshot({ scale: 1, transparent: true });
        const sum = (x, y) => pixels[4 * (Math.floor(y * height) * width + Math.floor(x * width)) + 1];
        const row = Array.from({ length: width }, (_, x) => sum((x + 0.5) / width, 0.5));
        return { crevice: sum(0.5, 0.5), free: sum(0.72, 0.5), darkest: Math.min(...row.filter((v) => v > 0)) };
      };
      return { plain: sums({}), occlusion: sums({ occlusion: true }), lines: sums({ silhouettes: true }) };
    });
    const { plain, occlusion, lines } = found;
    assert.ok(occlusion.crevice < 0.85 * plain.crevice, JSON.stringify(found));
    assert.ok(occlusion.free > 0.95 * plain.free, JSON.stringify(found));
    assert.ok(lines.darkest < 0.6 * plain.darkest, JSON.stringify(found));
    assert.ok(Math.abs(lines.free - plain.free) <= 2, JSON.stringify(found));
  });

  test("occlusion in images is smooth where the surface is", MORE, async () => {
    const bends = await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      // Spheres of some flat triangles that meet, seen aslant: their slopes darken each other.
      await addSphere({ radius: 10, center: [-9, 0, 0], segments: 40 });
      await addSphere({ radius: 10, center: [9, 0, 0], segments: 40 });
      // What is shown is large, so that occlusion reaches far.
      await addSphere({ radius: 1, center: [28, 28, 28], segments: 8 });
      await addSphere({ radius: 1, center: [-28, 28, -28], segments: 8 });
      scene.camera.restore({ position: [22, -38, 14], target: [0, 0, 0] });
      const shot = (occlusion) => {
        scene.setLook({ occlusion, silhouettes: false });
        return scene.snapshot({ scale: 2, transparent: true });
      };
      const [plain, dark] = [shot(false), shot(true)];
      const ratio = (x, y) => dark.pixels[4 * (y * plain.width + x)] / plain.pixels[4 * (y * plain.width + x)];
      const bends = [];
      for (let y = 0; y < plain.height; y += 2)
        for (let x = 2; x < plain.width; x += 1) {
          const [a, b, c] = [ratio(x - 2, y), ratio(x - 1, y), ratio(x, y)];
          if (Math.max(a, b, c) < 0.95) bends.push(Math.abs(a - 2 * b + c));
        }
      return bends.sort((a, b) => a - b);
    });
    assert.ok(bends.length > 1000, `${bends.length} pixels are darkened`);
    const bend = bends[Math.floor(0.9 * bends.length)];
    assert.ok(bend < 0.048, `from pixel to pixel the shading bends by ${bend}`);
  });
});

describe("transparency", { timeout: 2 * TIMEOUT_MS }, () => {
  test("two nested spheres at 50 % have the analytic colour from six directions", async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ surface: 0, radius: 10 });
      await addSphere({ surface: 1, radius: 5 });
      scene.setLook({ material: "unlit", occlusion: false });
      scene.setSurfaceStyle(0, { opacity: 0.5, color: "#ff0000" });
      scene.setSurfaceStyle(1, { opacity: 0.5, color: "#0000ff" });
    });
    // Front to back: red, blue, blue, red, half of what is left each; then red, red where the outer one is alone.
    const over = (layers) => {
      let [rgb, left] = [[0, 0, 0], 1];
      for (const color of layers) {
        rgb = rgb.map((sum, c) => sum + left * 0.5 * color[c]);
        left *= 0.5;
      }
      return [...rgb.map((sum) => sum / (1 - left)), 255 * (1 - left)];
    };
    const [red, blue] = [[255, 0, 0], [0, 0, 255]];
    for (const axis of ["+x", "-x", "+y", "-y", "+z", "-z"]) {
      await page.evaluate((axis) => window.bench.scene.view(axis, false), axis);
      near(await pixel(0.5, 0.5), over([red, blue, blue, red]), 6, `both from ${axis}`);
      near(await pixel(0.5, 0.15), over([red, red]), 6, `the outer one from ${axis}`);
    }
    // On screen as in an image, over the white page.
    await still();
    const shot = PNG.sync.read(await page.screenshot());
    const at = 4 * (150 * shot.width + 200);
    const [r, g, b, a] = over([red, blue, blue, red]);
    near([...shot.data.subarray(at, at + 3)], [r, g, b].map((c) => (c * a) / 255 + 255 - a), 6, "on screen");
  });

  test("an opaque surface inside is seen through a translucent one, and hides what is behind", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ surface: 2, radius: 10 });
      await addSphere({ surface: 3, radius: 5 });
      scene.setLook({ material: "unlit", occlusion: false });
      scene.setSurfaceStyle(2, { opacity: 0.25, color: "#00ff00" });
      scene.setSurfaceStyle(3, { color: "#ffffff" });
      scene.home(false);
    });
    near(await pixel(0.5, 0.5), [191, 255, 191, 255], 6, "one layer before the opaque one");
    await page.evaluate(() => window.bench.scene.setLook({ colorMode: "level" }));
    near(await pixel(0.5, 0.5), [191, 255, 191, 255], 6, "colours of their own, whatever the look says");
    const found = await page.evaluate(async () => {
      const { scene } = window.bench;
      await window.bench.still();
      return Promise.all([undefined, 2, 3].map(async (through) => (await scene.pick(200, 150, through)).surface));
    });
    assert.deepEqual(found, [2, 2, 3], "the nearest one, and what is seen through it");
    await page.evaluate(() => window.bench.scene.setSurfaceStyle(3, { visible: false }));
    const [, , , alpha] = await pixel(0.5, 0.5);
    assert.ok(Math.abs(alpha - 255 * (1 - 0.75 ** 2)) < 6, `${alpha}`);
  });
});

describe("clipping", { timeout: 2 * TIMEOUT_MS }, () => {
  const share = (color) =>
    page.evaluate((color) => {
      const { width, height, pixels } = window.bench.scene.snapshot({ scale: 1, transparent: true });
      let found = 0;
      for (let i = 0; i < 4 * width * height; i += 4) if (color.every((c, k) => Math.abs(pixels[i + k] - c) < 6) && pixels[i + 3] === 255) found += 1;
      return found / (width * height);
    }, color);
  const setup = (top) =>
    page.evaluate(async (top) => {
      const { scene, addSphere } = window.bench;
      await addSphere({ surface: 0, radius: 10, top });
      await addSphere({ surface: 1, radius: 4 });
      scene.setLook({ material: "unlit", occlusion: false });
      scene.setSurfaceStyle(0, { color: "#ff0000" });
      scene.setSurfaceStyle(1, { color: "#00ff00" });
      scene.camera.projection = "orthographic";
      scene.view("+y", false);
      scene.setClip({ plane: { normal: [0, 1, 0], offset: 0 }, caps: true });
    }, top);
  /** Caps are darker: 0.62 of the light. */
  const capOf = [206, 0, 0];
  const innerCap = [0, 206, 0];

  test("a plane cuts open two nested spheres, and caps close both", async () => {
    await setup(1);
    const [outer, inner] = [await share(capOf), await share(innerCap)];
    // Discs of radius 10 and 4.
    assert.ok(Math.abs(inner / (outer + inner) - 0.16) < 0.01, `${inner} of ${outer + inner}`);
    near(await pixel(0.5, 0.5), [...innerCap, 255], 6, "the middle");
    await page.evaluate(() => window.bench.scene.setClip({ plane: { normal: [0, 1, 0], offset: 0 }, caps: false }));
    assert.equal(await share(capOf), 0);
    // Without caps the insides are seen: unlit, in their colours.
    near(await pixel(0.5, 0.5), [0, 255, 0, 255], 6, "the inside");
  });

  test("a surface that is open above is capped all the same", MORE, async () => {
    const closed = await (async () => {
      await setup(1);
      return share(capOf);
    })();
    await page.reload();
    await page.waitForFunction(() => window.bench !== undefined);
    await setup(0.9);
    const open = await share(capOf);
    assert.ok(open > 0.85 * closed && open < closed, `${open} of ${closed}`);
  });

  test("a box leaves what is inside, by number and by its handles", MORE, async () => {
    await setup(1);
    await page.evaluate(() => window.bench.scene.setClip({ box: { min: [-5, -5, -5], max: [5, 5, 5] }, caps: true }));
    await still();
    // The sphere contains the box: a square of its caps, 10 wide.
    const square = (await share(capOf)) + (await share(innerCap));
    const height = await page.evaluate(() => window.bench.heightAtTarget());
    const expected = 100 / (height * height * (SIZE.width / SIZE.height));
    assert.ok(Math.abs(square / expected - 1) < 0.04, `${square}, expected ${expected}`);

    const handle = page.getByRole("slider", { name: "Clip box, high z" });
    await handle.focus();
    const before = await page.evaluate(() => window.bench.scene.clip.box.max[2]);
    await page.keyboard.press("ArrowDown");
    const stepped = await page.evaluate(() => window.bench.scene.clip.box.max[2]);
    assert.ok(stepped < before && stepped > before - 2, `${stepped}`);
    const box = await handle.boundingBox();
    assert.ok(box.width >= 24 && box.height >= 24);
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2 + 30, { steps: 4 });
    await page.mouse.up();
    const dragged = await page.evaluate(() => window.bench.scene.clip.box.max[2]);
    const moved = (30 * height) / SIZE.height;
    assert.ok(Math.abs(stepped - dragged - moved) < 0.05 * moved + 0.05, `${stepped} to ${dragged}, expected ${moved} less`);
  });
});

describe("orientation", { timeout: 2 * TIMEOUT_MS }, () => {
  test("the cube's faces set views, and the scale bar tells the truth in both projections", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ radius: 10 });
      scene.annotations.unit = "mm";
      scene.home(false);
      await window.bench.still();
    });
    await page.getByRole("button", { name: "View from +Y" }).click();
    await still();
    const { position, target } = await pose();
    assert.ok(Math.abs(position[0] - target[0]) < 1e-3 && position[1] > 20 && Math.abs(position[2] - target[2]) < 1e-3, `${position}`);
    await page.getByRole("button", { name: "View from +Y" }).focus();
    await page.evaluate(() => (window.bench.scene.camera.projection = "orthographic"));
    await still();
    // In an orthographic view the sphere is as wide as it is.
    const covered = await page.evaluate(() => {
      const { width, height, pixels } = window.bench.scene.snapshot({ scale: 1, transparent: true });
      const row = Math.floor(height / 2);
      return Array.from({ length: width }, (_, x) => pixels[4 * (row * width + x) + 3]).filter((a) => a > 127).length;
    });
    const scale = page.locator(".scene-scale");
    const [, length, unit] = /^([\d.]+) (\w+)$/.exec(await scale.locator("span").textContent()) ?? [];
    const { width } = await scale.locator("i").boundingBox();
    assert.equal(unit, "mm");
    assert.ok(Math.abs((20 / covered / (Number(length) / width)) - 1) < 0.02, `${length} in ${width} pixels, the sphere's 20 in ${covered}`);
    await page.evaluate(() => window.bench.scene.camera.restore({ position: [0, 5, 0], target: [0, 0, 0], projection: "perspective" }));
    await still();
    const closer = Number((/^[\d.]+/.exec(await scale.locator("span").textContent()) ?? [])[0]);
    assert.ok(closer < Number(length) / 4, `${closer}`);
  });

  test("a world that is shown higher stays the world: places, poses and light are right, and the scale bar says it", async () => {
    const found = await page.evaluate(async () => {
      const { scene, addSphere, still } = window.bench;
      await addSphere({ radius: 15 });
      scene.camera.projection = "orthographic";
      scene.exaggeration = 2;
      scene.view("+x", false);
      await still();
      const { width, height, pixels } = scene.snapshot({ scale: 1, transparent: true });
      const rows = [];
      const columns = [];
      for (let i = 0; i < width * height; i += 1) if (pixels[4 * i + 3] > 128) rows.push(Math.floor(i / width)), columns.push(i % width);
      const extent = (list) => list.reduce((max, n) => Math.max(max, n), 0) - list.reduce((min, n) => Math.min(min, n), 1e9) + 1;
      const positions = await Promise.all([[200, 150], [210, 60], [180, 220]].map(async ([x, y]) => (await scene.pick(x, y)).position));
      const light = [];
      for (const flat of [false, true]) {
        scene.setLook({ flat });
        light.push([...scene.snapshot({ scale: 1, transparent: true }).pixels]);
      }
      const apart = light[0].map((value, i) => Math.abs(value - light[1][i])).sort((a, b) => a - b);
      const { position, target } = scene.camera.pose;
      scene.camera.restore({ position, target });
      await still();
      return { share: extent(rows) / extent(columns), positions, p98: apart[Math.floor(0.98 * apart.length)], target, restored: scene.camera.pose.position.map((n, i) => n - position[i]) };
    });
    assert.ok(Math.abs(found.share - 2) < 0.03, `twice as high as wide: ${found.share}`);
    for (const at of found.positions) assert.ok(Math.abs(Math.hypot(...at) - 15) < 0.15, `on the sphere: ${at}`);
    // The triangles' own normals are right whatever the vertices say.
    assert.ok(found.p98 < 12, `light of smooth and flat triangles is ${found.p98} apart`);
    for (const n of [...found.target, ...found.restored]) assert.ok(Math.abs(n) < 1e-4, `${n}`);
    assert.match(await page.locator(".scene-scale").innerText(), /· heights × 2$/);
  });

  test("the box has ticks at round coordinates", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ radius: 29 });
      scene.annotations.unit = "mm";
      scene.annotations.show({ box: true });
      scene.home(false);
      await window.bench.still();
    });
    const texts = await page.locator(".scene-labels span").allTextContents();
    for (const text of ["x (mm)", "y (mm)", "z (mm)", "−20", "0", "20"]) assert.ok(texts.includes(text), `${text} in ${texts}`);
  });
});

describe("picking, slices, values", { timeout: 2 * TIMEOUT_MS }, () => {
  test("a pixel's place in the world, its surface, and a marker there", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ radius: 10 });
      await addSphere({ surface: 1, radius: 3, center: [20, 0, 0] });
      await addSphere({ surface: 2, radius: 1, center: [-22, 0, 0] });
      scene.setLook({ material: "unlit", occlusion: false });
      scene.view("+y", false);
      await window.bench.still();
    });
    for (const projection of ["perspective", "orthographic"]) {
      const found = await page.evaluate(async (projection) => {
        const { scene } = window.bench;
        scene.camera.projection = projection;
        await window.bench.still();
        return [await scene.pick(200, 150), await scene.pick(4, 4)];
      }, projection);
      assert.equal(found[0].surface, 0);
      const radius = Math.hypot(...found[0].position);
      assert.ok(Math.abs(radius - 10) < 0.05 && found[0].position[1] > 9.9, `${projection}: ${found[0].position}`);
      assert.equal(found[1], undefined);
    }
    const side = await page.evaluate(() => {
      const { scene } = window.bench;
      const width = window.bench.heightAtTarget();
      // Seen from +y, +x is on the left.
      return scene.pick(200 - (20 / width) * 300, 150);
    });
    assert.equal(side.surface, 1);
    await page.evaluate(() => window.bench.scene.annotations.mark([{ position: [0, 10, 0], color: "#ff00ff", text: "here" }]));
    near(await pixel(0.5, 0.5), [255, 0, 255, 255], 2, "the marker");
    assert.equal(await page.getByText("here").count(), 1);
    await page.evaluate(() => window.bench.scene.annotations.mark([]));
    near(await pixel(0.5, 0.5), [0xd9, 0xd9, 0xd9, 255], 2, "no marker");
  });

  test("a slice has its samples in the window's greys, in its place", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ radius: 3, center: [0, -20, 0] });
      const samples = new Int16Array(21 * 21).map((_, i) => (i % 21) * 100 - 1000);
      // From x = −20 to 20 and z = 20 to −20, at y = 0; brighter with x.
      scene.setSlices([{ samples, size: [21, 21], origin: [-20, 0, 20], right: [2, 0, 0], down: [0, 0, -2], window: [-1000, 1000] }]);
      scene.camera.restore({ position: [0, -100, 0], target: [0, 0, 0], projection: "orthographic" });
      scene.setClip({ box: { min: [30, 30, 30], max: [31, 31, 31] }, caps: false });
      await window.bench.still();
    });
    const grey = async (x) => {
      const height = await page.evaluate(() => window.bench.heightAtTarget());
      return pixel(0.5 + x / (height * (SIZE.width / SIZE.height)), 0.5);
    };
    for (const x of [-15, -5, 5, 15]) {
      const value = 255 * (0.5 + x / 40);
      near(await grey(x), [value, value, value, 255], 4, `at ${x}`);
    }
    assert.equal((await grey(24))[3], 0);
  });

  test("rulers are lines of their width, dashed where the surface hides them, on screen and in images", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere } = window.bench;
      await addSphere({ radius: 10 });
      scene.setLook({ material: "unlit", occlusion: false });
      scene.annotations.measure([
        { points: [[-6, 11, 4], [6, 11, 4]], text: "before", at: [0, 11, 4], raised: 16 },
        { points: [[-6, 0, -4], [6, 0, -4]], text: "inside", at: [0, 0, -4], raised: -16 },
      ]);
      scene.view("+y", false);
      scene.camera.projection = "orthographic";
      await window.bench.still();
    });
    /** Of the picture's columns between 0.4 and 0.6, how many are dark around a height of the world; and how many rows are. */
    const darkness = (height, scale) =>
      page.evaluate(
        ([height, scale]) => {
          const { scene } = window.bench;
          const { width, height: rows, pixels, unitsPerPixel } = scene.snapshot({ scale, transparent: false });
          const row = Math.round(rows / 2 - height / unitsPerPixel);
          const isDark = (x, y) => pixels[4 * (y * width + x)] < 80;
          const xs = Array.from({ length: Math.round(0.2 * width) }, (_, i) => Math.round(0.4 * width) + i);
          const around = Array.from({ length: 12 * scale }, (_, i) => row - 6 * scale + i);
          const thick = xs.map((x) => around.filter((y) => isDark(x, y)).length);
          return { dark: thick.filter((n) => n > 0).length / xs.length, rows: Math.max(...thick) };
        },
        [height, scale],
      );
    for (const scale of [1, 3]) {
      const [before, inside] = [await darkness(4, scale), await darkness(-4, scale)];
      assert.equal(before.dark, 1, `${scale} ×: a whole line before the surface`);
      assert.ok(inside.dark > 0.35 && inside.dark < 0.75, `${scale} ×: ${inside.dark} of the line inside is dark`);
      assert.ok(Math.abs(before.rows - 2 * scale) <= 1, `${scale} ×: ${before.rows} rows`);
    }
    assert.deepEqual(await page.locator(".scene-labels span").allTextContents(), ["before", "inside"]);
  });

  test("values of vertices have the colours of their range", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere, COLOR_MAPS, colorTable } = window.bench;
      const id = await addSphere({ radius: 10 });
      scene.setLook({ material: "unlit", occlusion: false, colorMode: "value" });
      scene.colors.setValueColors(2, 4, colorTable(COLOR_MAPS.viridis));
      scene.setValues(id, new Float32Array(97 * 49).fill(3));
      scene.home(false);
    });
    near(await pixel(0.5, 0.5), [0x21, 0x91, 0x8c, 255], 4, "viridis in the middle");
    await page.evaluate(async () => {
      // In place of the first values; and a mesh that has none, before it.
      window.bench.scene.setValues(1, new Float32Array(97 * 49).fill(2));
      await window.bench.addSphere({ radius: 3, center: [-5.6, 4.5, 3] });
      await window.bench.still();
    });
    near(await pixel(0.5, 0.66), [0x44, 0x01, 0x54, 255], 4, "viridis at its low end");
    const [red, green, blue] = await pixel(0.5, 0.5);
    assert.ok(red === green && green === blue && red > 100 && red < 200, `grey without values: ${red}, ${green}, ${blue}`);
    await page.evaluate(() => {
      const { scene, COLOR_MAPS } = window.bench;
      scene.annotations.showColors({ stops: COLOR_MAPS.viridis, texts: ["2", "3", "4"], title: "error (mm)" });
    });
    await page.getByText("error (mm)").waitFor();
    const bar = await page.locator(".scene-colors i").boundingBox();
    const shot = PNG.sync.read(await page.screenshot());
    const at = 4 * (Math.round(bar.y + bar.height / 2) * shot.width + Math.round(bar.x + bar.width / 2));
    near([...shot.data.subarray(at, at + 3)], [0x21, 0x91, 0x8c], 6, "the bar's middle");
    const refused = await page.evaluate(() => {
      try {
        window.bench.scene.setValues(1, new Float32Array(3));
        return "";
      } catch (error) {
        return error.message;
      }
    });
    assert.match(refused, /3 values for a region mesh, expected one for each of its 4753 vertices/);
  });
});

describe("compare", { timeout: 2 * TIMEOUT_MS }, () => {
  test("the kept picture stays left of the line, which moves by keys and drags", MORE, async () => {
    await page.evaluate(async () => {
      const { scene, addSphere, still } = window.bench;
      scene.setLook({ material: "unlit", occlusion: false });
      const before = await addSphere({ radius: 10 });
      scene.view("+y", false);
      scene.keep();
      await addSphere({ radius: 4 });
      // As an edit that replaces the region.
      scene.swap([], [before]);
      scene.swipe(0.5, { kept: "before", now: "after" });
      await still();
    });
    const covered = () =>
      page.evaluate(() => {
        const { width, height, pixels } = window.bench.scene.snapshot({ scale: 1, transparent: true });
        const row = Math.floor(height / 2);
        const alpha = Array.from({ length: width }, (_, x) => pixels[4 * (row * width + x) + 3] > 127);
        return { left: alpha.slice(0, width / 2).filter(Boolean).length, right: alpha.slice(width / 2).filter(Boolean).length };
      });
    const { left, right } = await covered();
    assert.ok(Math.abs(right / left - 0.4) < 0.05, `${left} left, ${right} right`);
    const line = page.getByRole("slider", { name: "Border between the pictures" });
    await line.focus();
    for (let i = 0; i < 30; i += 1) await page.keyboard.press("ArrowRight");
    assert.equal(await line.getAttribute("aria-valuenow"), "100");
    await still();
    assert.ok((await covered()).right > 1.5 * right, "all before");
    await page.evaluate(() => window.bench.scene.release());
    const after = await covered();
    assert.ok(Math.abs(after.left - right) <= 2, "all after");
    assert.equal(await line.isVisible(), false);
  });
});

describe("images", { timeout: 2 * TIMEOUT_MS }, () => {
  test("a PNG has four times the size, what surrounds the surface is transparent, and bars and caption are in it", async () => {
    const encoded = await page.evaluate(async () => {
      const { scene, addSphere, composeImage, base64, COLOR_MAPS } = window.bench;
      await addSphere({ radius: 10 });
      scene.home(false);
      const snapshot = scene.snapshot({ scale: 4, transparent: true });
      const scaleBar = (unitsPerPixel) => scene.annotations.barFor(unitsPerPixel, 400);
      const colorBar = { stops: COLOR_MAPS.viridis, texts: ["0", "1", "2"], title: "error (mm)" };
      const parts = { ink: "#ff0000", scale: 4, caption: "A sphere", scaleBar, colorBar };
      return base64(await composeImage(snapshot, parts));
    });
    const { width, height, data } = PNG.sync.read(Buffer.from(encoded, "base64"));
    assert.deepEqual([width, height], [4 * SIZE.width, 4 * SIZE.height]);
    const at = (x, y) => [...data.subarray(4 * (y * width + x), 4 * (y * width + x) + 4)];
    assert.deepEqual(at(2, 2), [0, 0, 0, 0]);
    assert.equal(at(width / 2, height / 2)[3], 255);
    // The bar: 16 pixels of the page from the right, 14 wide, half of the height, high values above.
    const x = width - 4 * (16 + 7);
    near(at(x, height / 4 + 8), [0xfd, 0xe7, 0x25, 255], 8, "top of the colour bar");
    near(at(x, (3 * height) / 4 - 8), [0x44, 0x01, 0x54, 255], 8, "bottom of the colour bar");
    const red = (x0, y0, x1, y1) => {
      let found = 0;
      for (let y = y0; y < y1; y += 1) for (let px = x0; px < x1; px += 1) if (at(px, y)[0] > 200 && at(px, y)[1] < 60 && at(px, y)[3] > 128) found += 1;
      return found;
    };
    assert.ok(red(0, height - 120, width / 4, height) > 300, "scale bar");
    assert.ok(red(600, height - 110, 1000, height - 20) > 300, "caption");
  });

  test("a turntable is a zip of numbered PNGs that turn", MORE, async () => {
    const encoded = await page.evaluate(async () => {
      const { scene, addSphere, makeTurntable, base64 } = window.bench;
      await addSphere({ radius: 10 });
      await addSphere({ radius: 3, center: [14, 0, 0], surface: 1 });
      scene.setSurfaceStyle(1, { color: "#ff0000" });
      scene.view("+y", false);
      const steps = [];
      const zip = await makeTurntable((pose) => scene.snapshot({ scale: 1, transparent: true, pose }), {
        frames: 12,
        from: scene.camera.pose,
        parts: { ink: "#000000", scale: 1 },
        onProgress: (done) => steps.push(done),
      });
      if (steps.join() !== "1,2,3,4,5,6,7,8,9,10,11,12") throw new Error(steps.join());
      return base64(zip);
    });
    const zip = Buffer.from(encoded, "base64");
    // Stored files: name and bytes follow their local header.
    const files = new Map();
    const names = [...zip.toString("latin1").matchAll(/PK\x01\x02[\s\S]{42}(\d\d\.png)/g)].map(([, name]) => name);
    assert.deepEqual(names, Array.from({ length: 12 }, (_, i) => `${String(i).padStart(2, "0")}.png`));
    const signature = Buffer.from("\x89PNG\r\n\x1a\n", "latin1");
    for (let from = zip.indexOf(signature), i = 0; from >= 0; from = zip.indexOf(signature, from + 1), i += 1) {
      files.set(i, PNG.sync.read(zip.subarray(from, zip.indexOf("IEND", from) + 8)));
    }
    assert.equal(files.size, 12);
    const middle = ({ width, height, data }) => {
      let [sum, found] = [0, 0];
      for (let i = 0; i < 4 * width * height; i += 4) if (data[i] > 100 && data[i + 1] < 40) [sum, found] = [sum + ((i / 4) % width), found + 1];
      return found === 0 ? undefined : sum / found / width;
    };
    // Seen from +y, +x is on the left; half a turn later on the right.
    assert.ok(middle(files.get(0)) < 0.3 && middle(files.get(6)) > 0.7, `${middle(files.get(0))} and ${middle(files.get(6))}`);
  });
});
