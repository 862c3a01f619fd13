/** A slow line: a relay to a server on this machine, with a limited rate towards the client, a delay, and a queue. */

import { connect, createServer } from "node:net";

/** Bytes that the bottleneck holds, as time. */
const QUEUE_MS = 20;
const PACKET_BYTES = 4096;

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Passes bytes on after a delay, no faster than a rate. */
async function pump(from, to, bytesPerMs, delayMs) {
  const waiting = [];
  let wake = () => undefined;
  const write = async () => {
    for (;;) {
      while (waiting.length === 0) await new Promise((woken) => (wake = woken));
      const { at, bytes } = waiting.shift();
      if (at > performance.now()) await sleep(at - performance.now());
      if (bytes === null) return to.end();
      to.write(bytes);
    }
  };
  void write();
  const put = (at, bytes) => {
    waiting.push({ at, bytes });
    wake();
  };
  let free = 0;
  try {
    for await (const data of from) {
      for (let start = 0; start < data.length; start += PACKET_BYTES) {
        const bytes = data.subarray(start, start + PACKET_BYTES);
        free = Math.max(free, performance.now()) + bytes.length / bytesPerMs;
        put(free + delayMs, bytes);
        const ahead = free - performance.now() - QUEUE_MS;
        if (ahead > 0) await sleep(ahead);
      }
    }
  } catch {
    // The other end is gone.
  }
  put(performance.now(), null);
}

/** A relay to a port of this machine. */
export async function startRelay(port, mbit, roundTripMs) {
  const server = createServer((client) => {
    const target = connect(port, "127.0.0.1");
    for (const socket of [client, target]) socket.setNoDelay(true).on("error", () => socket.destroy());
    void pump(client, target, Infinity, roundTripMs / 2);
    void pump(target, client, mbit * 125, roundTripMs / 2);
  });
  await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
  return { port: server.address().port, stop: () => server.close() };
}
