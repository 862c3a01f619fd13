#!/usr/bin/env node
/**
 * Measures the time of a step to another time step, from the message to its `done`, as a player requests steps one after the other:
 * with and without reading ahead.
 *
 *     tests/scripts/steps.mjs FILE_OR_FOLDER [--iso V] [--field NAME] [--pause MS] [--runs N] [--binary PATH]
 *
 * Goes through all steps once from a cold device, and waits `--pause` milliseconds after each, as a player draws and shows it.
 * Needs web/node_modules, and a built server.
 */

import { spawn } from "node:child_process";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { createInterface } from "node:readline";
import { setTimeout as sleep } from "node:timers/promises";
import { parseArgs } from "node:util";

if (process.argv.includes("--help")) {
  const text = readFileSync(import.meta.filename, "utf8");
  console.log(text.slice(text.indexOf("/**"), text.indexOf("*/")).replace(/^[/ ]\*+ ?/gm, "").trim());
  process.exit();
}

const ROOT = resolve(import.meta.dirname, "../..");
const { WebSocket } = createRequire(resolve(ROOT, "web/package.json"))("ws");

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: {
    iso: { type: "string" },
    field: { type: "string" },
    pause: { type: "string", default: "100" },
    runs: { type: "string", default: "2" },
    binary: { type: "string", default: resolve(ROOT, "target/release/isopeel") },
  },
});

async function serve(readAhead) {
  const args = ["serve", "--no-auth", "--no-demo", "--listen", "127.0.0.1:0", "--read-ahead", String(readAhead), positionals[0]];
  const server = spawn(values.binary, args, { stdio: ["ignore", "pipe", "ignore"] });
  for await (const line of createInterface(server.stdout)) return { server, address: line.trim() };
  throw new Error("the server did not start");
}

/** Milliseconds of each step, and the bytes of its chunks. */
async function play(address) {
  const [volume] = await (await fetch(`${address}/api/v1/volumes`)).json();
  const socket = new WebSocket(`${address.replace("http", "ws")}/api/v1/stream`, "isopeel.v3");
  let bytes = 0;
  const waiting = [];
  socket.on("message", (data, isBinary) => {
    if (isBinary) return (bytes += data.length);
    const message = JSON.parse(data.toString("utf8"));
    if (message.type === "error") throw new Error(message.message);
    for (const wait of waiting.filter(({ type }) => type === message.type)) {
      waiting.splice(waiting.indexOf(wait), 1);
      wait.resolve(message);
    }
  });
  await new Promise((done) => socket.once("open", done));
  const until = (type) => new Promise((resolve) => waiting.push({ type, resolve }));
  const ask = (message, type) => {
    const answer = until(type);
    socket.send(JSON.stringify(message));
    return answer;
  };
  await ask({ type: "open", volume: volume.id }, "opened");
  const edit = { iso: values.iso === undefined ? undefined : Number(values.iso), field: values.field };
  await ask({ type: "edit", ...edit }, "done");
  const steps = [];
  for (let step = 1; step < volume.steps; step += 1) {
    await sleep(Number(values.pause));
    const before = [performance.now(), bytes];
    await ask({ type: "step", step }, "stepped");
    await until("done");
    steps.push({ ms: performance.now() - before[0], bytes: bytes - before[1] });
  }
  socket.close();
  return steps;
}

const median = (numbers) => numbers.toSorted((a, b) => a - b)[numbers.length >> 1];

for (const readAhead of [0, 1024, 0, 1024].slice(0, 2 * Number(values.runs))) {
  const { server, address } = await serve(readAhead);
  try {
    const steps = await play(address);
    // Without the first step, which cannot be read ahead.
    const ms = steps.slice(1).map((step) => step.ms);
    console.log(
      `--read-ahead ${readAhead}: ${steps.length} steps, median ${median(ms).toFixed(0)} ms, ` +
        `slowest ${Math.max(...ms).toFixed(0)} ms, ${(median(steps.map((step) => step.bytes)) / 1000).toFixed(0)} kB a step`,
    );
  } finally {
    server.kill();
  }
}
