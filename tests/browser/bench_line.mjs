/**
 * Times of edits over a slow line: `node bench_line.mjs [VOLUME…] [--mbit N] [--round-trip MS] [--detail view|uniform] [--repeats N] [--json]`.
 *
 * Without a browser: a client of the stream that asks for what the page asks for, behind a relay with a limited rate towards the client, a
 * delay, and a queue of 20 ms. For each volume, at the settings with which it opens (the demo volume without files):
 *
 * - single edits of α, the transfer function and the budget, from rest: until the first commit has arrived, and until `done` has;
 * - drags of 2.5 s of each, 20 edits a second: longest time between commits, time from the last edit to the final surface, and the bytes
 *   that arrive in that time beside those of the final surface's chunks;
 * - bytes of a triangle of the final surface, with headers.
 */

import { parseArgs } from "node:util";
import WebSocket from "ws";
import { startServer } from "./harness.mjs";
import { startRelay } from "./relay.mjs";

const { values: options, positionals: volumes } = parseArgs({
  allowPositionals: true,
  options: {
    mbit: { type: "string", default: "5" },
    "round-trip": { type: "string", default: "80" },
    detail: { type: "string", default: "view" },
    repeats: { type: "string", default: "5" },
    json: { type: "boolean" },
  },
});
const [MBIT, ROUND_TRIP_MS, REPEATS] = [Number(options.mbit), Number(options["round-trip"]), Number(options.repeats)];
const [DRAGS, DRAG_MS, HZ] = [3, 2500, 20];
/** A client that takes no message for this time has the final surface. */
const QUIET_MS = 1000;
/** The window of the page in the figures: the picture beside the cards. */
const VIEWPORT = [1240, 936];
const FOV = 32;
const LOOKING_FROM = [0.66, -0.66, 0.36];

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Offsets in a chunk's header. */
const [HEADER_BYTES, SIZE_AT, REGION_AT] = [96, 18, 20];

/** A viewer that remembers when each commit arrived, and how many bytes had arrived by then. */
class Viewer {
  commits = [];
  done = 0;
  bytes = 0;
  /** Bytes of the chunks of the surface that is shown, by region. */
  shown = new Map();
  lastMessage = 0;

  constructor(port) {
    this.socket = new WebSocket(`ws://127.0.0.1:${port}/api/v1/stream`, ["isopeel.v3"], { perMessageDeflate: false });
    this.connected = new Promise((open) => this.socket.on("open", open));
    this.opened = new Promise((opened, failed) => {
      this.socket.on("error", failed);
      this.socket.on("message", (data, isBinary) => {
        this.bytes += data.length;
        if (isBinary) return this.onChunk(data);
        const message = JSON.parse(data);
        const at = performance.now();
        if (message.type !== "heartbeat") this.lastMessage = at;
        if (message.type === "opened") opened(message);
        if (message.type === "error") throw new Error(message.message);
        if (message.type === "prefix") {
          this.triangles = message.triangles;
          if (message.unchanged === 0) this.shown.clear();
        }
        if (message.type === "committed") this.commits.push({ at, bytes: this.bytes, triangles: this.triangles });
        if (message.type === "done") this.done += 1;
      });
    });
  }

  onChunk(data) {
    const region = data.toString("hex", SIZE_AT, REGION_AT + 12);
    if (data.length > HEADER_BYTES) this.shown.set(region, data.length);
    else this.shown.delete(region);
  }

  /** Bytes of the surface that is shown. */
  get shownBytes() {
    return [...this.shown.values()].reduce((sum, bytes) => sum + bytes, 0);
  }

  send(message) {
    this.socket.send(JSON.stringify(message));
  }

  /** Waits for the final surface, and for what follows it at rest. */
  async rest() {
    const { done } = this;
    while (this.done === done || performance.now() - this.lastMessage < QUIET_MS) await sleep(5);
  }
}

/** A camera from which the whole volume is in sight, as that with which the page opens. */
function openingCamera({ dims, spacing, origin, direction }) {
  const extent = dims.map((count, axis) => (count - 1) * spacing[axis]);
  const target = origin.map((at, world) => at + extent.reduce((sum, length, axis) => sum + (direction[axis][world] * length) / 2, 0));
  const away = Math.hypot(...extent) / 2 / Math.sin((FOV / 2) * (Math.PI / 180));
  return { position: target.map((at, world) => at + LOOKING_FROM[world] * away), target, up: [0, 0, 1], fov: FOV, viewport: VIEWPORT };
}

/** Edits of each kind, by a number from 0 to 1. */
function kindsOf({ transferFunction: { points } }) {
  const [first, last] = [points[0], points.at(-1)];
  return {
    alpha: (at) => ({ alpha: 0.05 + 0.9 * at }),
    "transfer function": (at) => ({ transferFunction: { points: [first, { ...first, x: 0.3 + 0.3 * at, importance: 0.2 + 0.5 * at }, last] } }),
    budget: (at) => ({ error: "1px", triangles: { share: 0.15 + 0.2 * at, max: 1_000_000 } }),
  };
}

/** Single edits from rest. */
async function singles(viewer, editOf) {
  const edits = [];
  for (let i = 0; i < REPEATS; i += 1) {
    // No two are equal, because the surface of a view is cached.
    const [commits, bytes, began] = [viewer.commits.length, viewer.bytes, performance.now()];
    viewer.send({ type: "edit", ...editOf((0.1 + 0.37 * (i + 1)) % 1) });
    await viewer.rest();
    const steps = viewer.commits.slice(commits);
    edits.push({
      first: steps[0].at - began,
      settled: steps.at(-1).at - began,
      steps: steps.map((step, i) => ({ ms: Math.round(step.at - began), triangles: step.triangles, bytes: step.bytes - (steps[i - 1]?.bytes ?? bytes) })),
    });
  }
  return edits;
}

/** A drag: many edits, one after the other. @param shift makes the edits of each drag differ, because the surface of a view is cached */
async function drag(viewer, editOf, shift) {
  const [commits, began, count] = [viewer.commits.length, performance.now(), (DRAG_MS / 1000) * HZ];
  for (let i = 1; i <= count; i += 1) {
    viewer.send({ type: "edit", ...editOf((0.95 * i) / count + shift) });
    await sleep(began + (1000 * i) / HZ - performance.now());
  }
  const [released, bytes] = [performance.now(), viewer.bytes];
  await viewer.rest();
  const seen = viewer.commits.slice(commits).map(({ at }) => at);
  const times = [began, ...seen.filter((at) => at < released), released];
  const last = viewer.commits.at(-1);
  return {
    gap: Math.max(...times.slice(1).map((at, i) => at - times[i])),
    commits: times.length - 2,
    settled: Math.max(0, last.at - released),
    share: (last.bytes - bytes) / viewer.shownBytes,
    finalBytes: viewer.shownBytes,
    triangles: last.triangles,
  };
}

async function measure(port, id) {
  const viewer = new Viewer(port);
  await viewer.connected;
  viewer.send({ type: "heartbeat" });
  viewer.send({ type: "open", volume: id, step: 0, codings: ["predictive"] });
  const opened = await viewer.opened;
  if (options.detail === "view") viewer.send({ type: "camera", camera: openingCamera(opened.volume.geometry) });
  viewer.send({ type: "edit", detail: options.detail });
  await viewer.rest();
  const kinds = {};
  for (const [kind, editOf] of Object.entries(kindsOf(opened.edit))) {
    const edits = await singles(viewer, editOf);
    const drags = [];
    for (let i = 0; i < DRAGS; i += 1) drags.push(await drag(viewer, editOf, 0.01 * i));
    kinds[kind] = { edits, drags };
    viewer.send({ type: "edit", ...opened.edit });
    await viewer.rest();
  }
  viewer.socket.close();
  return kinds;
}

const sorted = (numbers) => [...numbers].sort((a, b) => a - b);
const seconds = (ms) => (ms / 1000).toFixed(3);

const server = await startServer(volumes, { demo: volumes.length === 0 });
const relay = await startRelay(server.port, MBIT, ROUND_TRIP_MS);
try {
  const listed = await (await fetch(`${server.url}/api/v1/volumes`)).json();
  for (const { id } of listed.volumes ?? listed) {
    const kinds = await measure(relay.port, id);
    for (const [kind, { edits, drags }] of Object.entries(kinds)) {
      if (options.json) console.log(JSON.stringify({ id, kind, edits, drags }));
      const [first, settled] = [sorted(edits.map(({ first }) => first)), sorted(edits.map(({ settled }) => settled))];
      const middle = Math.floor(edits.length / 2);
      console.log(`${id}, ${options.detail}, ${MBIT} Mbit/s, ${ROUND_TRIP_MS} ms, ${kind}:`);
      console.log(`  edit → first commit ${seconds(first[0])} ${seconds(first[middle])} ${seconds(first.at(-1))} s (best, median, worst), settled ${seconds(settled[middle])} s`);
      console.log(`  steps of the last edit: ${edits.at(-1).steps.map(({ ms, triangles, bytes }) => `${triangles} triangles, ${bytes} bytes, ${ms} ms`).join("; ")}`);
      const of = (name, digits = 3) => {
        const all = sorted(drags.map((drag) => drag[name] / (digits === 3 ? 1000 : 1)));
        return `${all[Math.floor(all.length / 2)].toFixed(digits)} (${all.at(-1).toFixed(digits)})`;
      };
      const { finalBytes, triangles } = drags.at(-1);
      console.log(
        `  ${drags.length} drags, median (worst): longest gap ${of("gap")} s of ${of("commits", 0)} commits, settled ${of("settled")} s after release, ` +
          `bytes after it ÷ final ${of("share", 2)}; ${(finalBytes / triangles).toFixed(2)} bytes a triangle of ${triangles}`,
      );
    }
  }
} finally {
  relay.stop();
  await server.stop();
}
