/**
 * From the camera at rest to the surface for it, after a zoom from far: `node bench_zoom.mjs [VOLUME…] [--zooms N] [--steps N] [--json]`.
 *
 * Server, headless chromium and software rendering on one machine, at the settings with which a volume opens. Without files: `sin` of 512³
 * samples. In each zoom the wheel turns once a frame, at the middle of the picture, for `--steps` frames, as fast as the page draws. The
 * camera moves on for a while, as its motion is damped. From its last motion on:
 *
 * - *surface*: until the surface for this camera is drawn, *picture*: until the last frame is, in full quality;
 * - *dropped*: frames of 1/60 s in which the page's thread was busy, and the same after equal zooms in a surface that does not follow
 *   the camera: what refining adds to what drawing takes.
 */

import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { parseArgs } from "node:util";
import { settled, startServer, writeVolume } from "./harness.mjs";
import { openQuietPage } from "./quiet_page.mjs";

const { values: options, positionals } = parseArgs({
  allowPositionals: true,
  options: { zooms: { type: "string", default: "6" }, steps: { type: "string", default: "40" }, json: { type: "boolean" } },
});
const [ZOOMS, STEPS] = [Number(options.zooms), Number(options.steps)];
/** No frame, and nothing awaited, for this time: the page is at rest. */
const QUIET_MS = 800;

/** Runs in the page before its own code: records frames, motion and surfaces. */
function observe() {
  localStorage.setItem("isopeel.tour", "seen");
  const waitForGpu = () => {
    const gl = document.querySelector(".viewport canvas").getContext("webgl2");
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
  let record;
  let steps = 0;
  const sockets = new Set();
  const NativeSocket = WebSocket;
  window.WebSocket = class extends NativeSocket {
    constructor(...args) {
      super(...args);
      sockets.add(this);
      this.addEventListener("message", ({ data }) => {
        if (record === undefined) return;
        if (typeof data !== "string") record.bytes.push([performance.now(), data.byteLength]);
        else if (JSON.parse(data).type === "done") record.done.push(performance.now());
      });
    }
    send(data) {
      if (record !== undefined && typeof data === "string" && data.startsWith('{"type":"camera"')) record.cameras.push(performance.now());
      super.send(data);
    }
  };
  const canvas = () => document.querySelector(".viewport canvas");
  const turn = (deltaY) => {
    const { left, top, width, height } = canvas().getBoundingClientRect();
    const at = { clientX: left + width / 2, clientY: top + height / 2 };
    canvas().dispatchEvent(new WheelEvent("wheel", { ...at, deltaY, bubbles: true, cancelable: true }));
  };
  const frame = () => {
    const now = performance.now();
    if (record !== undefined) {
      const { camera, framesDrawn, generation, triangles, settled, statistics } = window.isopeel.status;
      const place = JSON.stringify([camera.position, camera.target]);
      record.frames.push(now);
      if (place !== record.place) Object.assign(record, { place, rest: now });
      if (framesDrawn !== record.framesDrawn) {
        waitForGpu();
        Object.assign(record, { framesDrawn, picture: performance.now() });
        if (generation !== record.generation) Object.assign(record, { generation, triangles, surface: performance.now() });
      }
      Object.assign(record, { settled, within: statistics?.pixels?.within, limitedBy: statistics?.pixels?.limitedBy });
      if (steps > 0) {
        steps -= 1;
        turn(-30);
        record.rest = now;
      }
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  window.bench = {
    zoom: (count) => {
      const { camera, framesDrawn, generation } = window.isopeel.status;
      const place = JSON.stringify([camera.position, camera.target]);
      record = { place, framesDrawn, generation, began: performance.now(), rest: performance.now(), frames: [], cameras: [], done: [], bytes: [], from: camera };
      steps = count;
    },
    isOver: (quietMs) => steps === 0 && record.settled && performance.now() - Math.max(record.rest, record.picture ?? 0, record.cameras.at(-1) ?? 0) > quietMs,
    take: () => {
      const taken = { ...record, to: window.isopeel.status.camera };
      record = undefined;
      return taken;
    },
  };
}

const distance = ({ position, target }) => Math.hypot(...position.map((at, axis) => at - target[axis]));

/** One zoom into the surface of a page that was just opened. */
async function zoom(url) {
  const page = await openQuietPage(url, { width: 1100, height: 760, script: `(${observe})()` });
  try {
    await settled(page);
    // The better surface, the measured error and the frame in full quality.
    await page.waitForFunction(() => window.isopeel.status.statistics?.error !== null, undefined, { polling: 100 });
    await new Promise((done) => setTimeout(done, QUIET_MS));
    await page.evaluate((steps) => window.bench.zoom(steps), STEPS);
    await page.waitForFunction((quiet) => window.bench.isOver(quiet), QUIET_MS, { polling: 100 });
    const record = await page.evaluate(() => window.bench.take());
    const { rest, picture } = record;
    const surface = Math.max(rest, record.surface ?? rest);
    const times = record.frames.filter((at) => at >= rest && at <= Math.max(surface, picture) + 50);
    const gaps = times.slice(1).map((at, i) => at - times[i]);
    const ofMotion = record.frames.filter((at) => at <= rest);
    return {
      surface: surface - rest,
      picture: Math.max(0, (picture ?? rest) - rest),
      sent: (record.cameras.at(-1) ?? rest) - rest,
      done: (record.done.at(-1) ?? rest) - rest,
      kilobytes: Math.round(record.bytes.filter(([at]) => at > rest).reduce((sum, [, bytes]) => sum + bytes, 0) / 1000),
      dropped: gaps.reduce((sum, gap) => sum + Math.max(0, Math.round(gap / (1000 / 60)) - 1), 0),
      longest: Math.max(0, ...gaps),
      moving: (1000 * (ofMotion.length - 1)) / (rest - record.began),
      cuts: record.done.filter((at) => at <= rest).length / ((rest - record.began) / 1000),
      nearer: distance(record.from) / distance(record.to),
      triangles: record.triangles,
      within: record.within,
      limitedBy: record.limitedBy,
    };
  } finally {
    await page.close();
  }
}

const middle = (numbers) => [...numbers].sort((a, b) => a - b)[Math.floor(numbers.length / 2)];

const folder = mkdtempSync(join(tmpdir(), "isopeel-zoom-"));
try {
  const files = positionals.length > 0 ? positionals : [writeVolume(folder, 512)];
  for (const file of files) {
    const server = await startServer([file]);
    try {
      const listed = await (await fetch(`${server.url}/api/v1/volumes`)).json();
      const [{ id }] = listed.volumes ?? listed;
      for (const detail of ["view", "uniform"]) {
        const zooms = [];
        for (let i = 0; i < ZOOMS; i += 1) zooms.push(await zoom(`${server.url}/#v=1&volume=${id}${detail === "view" ? "" : "&detail=uniform"}`));
        if (options.json) console.log(JSON.stringify({ file: basename(file), detail, zooms }));
        const of = (name, digits = 0) => {
          const all = zooms.map((zoom) => zoom[name]);
          return [Math.min(...all), middle(all), Math.max(...all)].map((n) => n.toFixed(digits)).join(" / ");
        };
        const [{ triangles, within, limitedBy }] = zooms;
        console.log(`${basename(file)}, ${detail}: ${zooms.length} zooms, ${of("nearer", 1)} times as near, ${triangles} triangles, ${within?.toFixed(2)} px (${limitedBy}); best, median and worst:`);
        console.log(`  after rest, ms: camera sent ${of("sent")}, done ${of("done")}, surface ${of("surface")}, picture ${of("picture")}; ${of("kilobytes")} kB`);
        console.log(`  dropped ${of("dropped")}, longest frame ${of("longest")} ms; while moving ${of("moving", 1)} frames and ${of("cuts", 1)} cuts a second`);
      }
    } finally {
      await server.stop();
    }
  }
} finally {
  rmSync(folder, { recursive: true });
}
