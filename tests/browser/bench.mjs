/**
 * Times from an input event to the first frame of its edit: `node bench.mjs [--edits N] [--mbit N --round-trip MS] [--json]`.
 *
 * Server, headless chromium and software rendering on one machine, with the demo volume. Edits the isovalue and α from the
 * keyboard, each when the last one is settled. The page's sockets, worker and animation frames are observed from outside; the
 * viewer has no code for it. A frame counts when the GPU has finished it. With `--mbit` the page is behind a relay of this rate, and a
 * round trip of that many milliseconds.
 */

import { parseArgs } from "node:util";
import { settled, startServer } from "./harness.mjs";
import { openQuietPage } from "./quiet_page.mjs";
import { startRelay } from "./relay.mjs";

const { values: options } = parseArgs({ options: { edits: { type: "string", default: "20" }, mbit: { type: "string" }, "round-trip": { type: "string", default: "40" }, json: { type: "boolean" } } });
const EDITS = Number(options.edits);

/** Keys and the numbers that the browser knows them by. */
const RIGHT = ["ArrowRight", 39];

/** One key's edit each. The isovalue goes one way, for the server keeps what it knows of the isovalues before. */
const SCENARIOS = [
  { name: "isovalue", slider: "Isovalue", key: () => RIGHT },
  { name: "α", slider: "Balance α", key: () => RIGHT },
];

/** Moments between the event and its frame, in order. */
const MOMENTS = ["sent", "prefix", "committed", "decoded", "submitted", "drawn"];

/** Runs in the page before its own code: records when each moment of an edit is reached. */
function observe() {
  localStorage.setItem("isopeel.tour", "seen");
  let generation = 0;
  let framesDrawn = 0;
  let edit;
  const record = (moment) => {
    if (edit !== undefined) edit.at[moment] ??= performance.now() - edit.began;
  };
  /** Reading a pixel waits until the GPU is done. */
  const waitForGpu = () => {
    const gl = document.querySelector(".viewport canvas").getContext("webgl2");
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
  window.bench = {
    /** The next input event of this type begins an edit. Waits for the frame before it, so that an edit from rest is measured. */
    arm: (type) => {
      waitForGpu();
      edit = undefined;
      ({ generation, framesDrawn } = window.isopeel.status);
      const began = (event) => {
        edit = { began: event.timeStamp, at: {}, bytes: 0, chunks: 0 };
      };
      addEventListener(type, began, { capture: true, once: true });
    },
    edit: () => edit,
  };

  const { send } = WebSocket.prototype;
  WebSocket.prototype.send = function (data) {
    if (typeof data === "string" && data.includes('"edit"')) record("sent");
    return send.call(this, data);
  };
  const NativeSocket = WebSocket;
  window.WebSocket = class extends NativeSocket {
    constructor(...args) {
      super(...args);
      this.addEventListener("message", ({ data }) => {
        if (edit === undefined) return;
        if (typeof data !== "string") {
          if (edit.at.committed === undefined) {
            edit.bytes += data.byteLength;
            edit.chunks += 1;
          }
          return;
        }
        const message = JSON.parse(data);
        if (message.type === "prefix" && message.generation > generation) {
          record("prefix");
          edit.level ??= message.level;
        }
        if (message.type === "committed" && message.generation > generation) record("committed");
        if (message.type === "done") record("done");
      });
    }
  };
  const NativeWorker = Worker;
  window.Worker = class extends NativeWorker {
    constructor(...args) {
      super(...args);
      // The last reply before the frame.
      this.addEventListener("message", () => {
        if (edit !== undefined && edit.at.submitted === undefined) edit.at.decoded = performance.now() - edit.began;
      });
    }
  };
  const request = requestAnimationFrame;
  window.requestAnimationFrame = (callback) =>
    request((time) => {
      callback(time);
      if (edit === undefined || edit.at.submitted !== undefined) return;
      const status = window.isopeel.status;
      if (status.framesDrawn > framesDrawn && status.generation > generation) {
        record("submitted");
        waitForGpu();
        record("drawn");
        edit.triangles = status.triangles;
      } else if (status.framesDrawn > framesDrawn) {
        edit.framesBefore = (edit.framesBefore ?? 0) + 1;
      }
      framesDrawn = status.framesDrawn;
    });
}

const median = (numbers) => {
  const sorted = [...numbers].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)];
};

async function measure(page, scenario) {
  const edits = [];
  for (let i = 0; i < EDITS; i += 1) {
    await page.evaluate((label) => {
      const named = [...document.querySelectorAll("label")].filter(({ textContent }) => textContent === label);
      const range = named.map(({ control }) => control).find(({ type }) => type === "range");
      (range ?? document.querySelector(`[role=slider][aria-label="${label}"]`)).focus();
    }, scenario.slider);
    const { generation } = await settled(page);
    await page.evaluate(() => window.bench.arm("keydown"));
    await page.press(...scenario.key(i));
    await settled(page, (now, before) => now.generation > before, generation);
    edits.push(await page.evaluate(() => window.bench.edit()));
  }
  return edits;
}

const server = await startServer([], { demo: true });
const relay = options.mbit === undefined ? undefined : await startRelay(server.port, Number(options.mbit), Number(options["round-trip"]));
let page;
try {
  page = await openQuietPage(`http://127.0.0.1:${relay?.port ?? server.port}/#v=1&volume=mni152`, { width: 1100, height: 760, script: `(${observe})()` });
  await settled(page);
  await page.evaluate(() => (document.querySelector("details.expert").open = true));
  for (const scenario of SCENARIOS) {
    const edits = await measure(page, scenario);
    if (options.json) console.log(JSON.stringify({ scenario: scenario.name, edits }));
    const of = (moment) => edits.map(({ at }) => at[moment]).filter((ms) => ms !== undefined);
    console.log(`${scenario.name}: ${edits.length} edits; best, median and worst in ms since the event`);
    for (const moment of [...MOMENTS, "done"]) {
      const figures = [Math.min(...of(moment)), median(of(moment)), Math.max(...of(moment))];
      console.log(`  ${moment.padEnd(10)}${figures.map((ms) => ms.toFixed(0).padStart(6)).join("")}`);
    }
    const levels = edits.map(({ level }) => level);
    console.log(
      `  first prefix: level ${[...new Set(levels)].join(" or ")}, ` +
        `${median(edits.map(({ triangles }) => triangles))} triangles, ${median(edits.map(({ bytes }) => bytes))} bytes; ` +
        `${median(edits.map(({ framesBefore }) => framesBefore ?? 0))} frames drawn before it`,
    );
  }
} finally {
  await page?.close();
  relay?.stop();
  await server.stop();
}
