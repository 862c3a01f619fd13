import { MeshoptDecoder } from "meshoptimizer/decoder";
import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket } from "ws";
import { decodeChunk } from "../src/decode/decode";
import type { DecodeWorker } from "../src/decode/queue";
import { DecodeQueue } from "../src/decode/queue";
import type { DecodeReply, DecodeRequest } from "../src/decode/worker";
import { StreamClient } from "../src/net/streamClient";
import { Throttle } from "../src/net/throttle";
import { readChunkHeader } from "../src/protocol/chunk";
import { parseServerMessage } from "../src/protocol/messages";
import type { ServerMessage } from "../src/protocol/types";
import { RegionPipeline, type RegionScene } from "../src/regions/pipeline";
import { FixtureServer, OPENING } from "./fixture";
import { surfaceNets, wobblyBall } from "./synthetic";

/** Decodes as the worker does, in this thread. */
class LocalWorker implements DecodeWorker {
  onmessage: DecodeWorker["onmessage"] = null;
  onerror: DecodeWorker["onerror"] = null;
  readonly requests: number[] = [];
  postMessage({ id, frame }: DecodeRequest): void {
    this.requests.push(id);
    void MeshoptDecoder.ready.then(() => {
      const data: DecodeReply = { id, chunk: decodeChunk(MeshoptDecoder, readChunkHeader(frame), frame) };
      this.onmessage?.({ data } as MessageEvent<DecodeReply>);
    });
  }
}

/** A scene without WebGL: what is uploaded is resident in the next task. */
class PlainScene implements RegionScene {
  readonly ready = new Map<number, number>();
  readonly shown = new Map<number, number>();
  onResident: (id: number) => void = () => undefined;
  upload(id: number, { indices }: { indices: ArrayLike<number> }): void {
    setTimeout(() => {
      this.ready.set(id, indices.length / 3);
      this.onResident(id);
    });
  }
  swap(show: readonly number[], remove: readonly number[]): void {
    for (const id of remove) expect(this.shown.delete(id)).toBe(true);
    for (const id of show) {
      this.shown.set(id, this.ready.get(id)!);
      this.ready.delete(id);
    }
  }
  drop(ids: readonly number[]): void {
    for (const id of ids) this.ready.delete(id);
  }
  clear(): void {
    this.shown.clear();
  }
  get triangles(): number {
    return [...this.shown.values()].reduce((sum, n) => sum + n, 0);
  }
}

class Client {
  readonly messages: ServerMessage[] = [];
  readonly states: string[] = [];
  readonly broken: string[] = [];
  readonly scene = new PlainScene();
  readonly pipeline: RegionPipeline;
  readonly stream: StreamClient;

  constructor(port: number) {
    this.pipeline = new RegionPipeline(new LocalWorker(), this.scene, {
      onSwap: () => undefined,
      onBroken: (reason) => this.broken.push(reason),
    });
    this.scene.onResident = (id) => this.pipeline.resident(id);
    this.stream = new StreamClient(`ws://127.0.0.1:${port}/api/v1/stream`, {
      onState: (state) => this.states.push(state),
      onReset: () => void this.pipeline.event({ type: "reset" }),
      onChunk: (frame) => this.pipeline.chunk(frame),
      onBroken: (reason) => this.broken.push(reason),
      onEditSent: () => undefined,
      onMessage: (message) => {
        this.messages.push(message);
        if (message.type === "prefix" || message.type === "committed" || message.type === "superseded") {
          this.pipeline.event(message);
        }
      },
    });
  }

  of<T extends ServerMessage["type"]>(type: T): Extract<ServerMessage, { type: T }>[] {
    return this.messages.filter((m): m is Extract<ServerMessage, { type: T }> => m.type === type);
  }

  /** The final surface of at least this many finished generations is shown. */
  async done(times = 1): Promise<void> {
    await vi.waitFor(() => {
      // A better surface of the same generation is done once more.
      const finished = this.of("done").filter((done, i, all) => done.generation !== all[i - 1]?.generation);
      expect(finished.length).toBeGreaterThanOrEqual(times);
      expect(this.pipeline.settled).toBe(true);
    }, 20_000);
  }
}

const trianglesAt = (level: number, step = 0, iso = 0) =>
  surfaceNets(wobblyBall(step), iso, level).reduce((sum, m) => sum + m.indices.length / 3, 0);

let server: FixtureServer;
let client: Client;
let port: number;

beforeEach(async () => {
  vi.stubGlobal("WebSocket", WebSocket);
  server = new FixtureServer();
  server.paceMs = 2;
  port = await server.listen();
  client = new Client(port);
});

afterEach(async () => {
  client.stream.stop();
  await server.close();
  vi.unstubAllGlobals();
});

describe("the stream client", () => {
  test("opens, extracts and shows the final surface", async () => {
    client.stream.open("ball", 0);
    client.stream.start();
    await client.done();
    expect(server.received).toEqual([{ type: "open", volume: "ball", step: 0 }, { type: "edit" }]);
    expect(client.scene.triangles).toBe(trianglesAt(0));
    expect(client.scene.ready.size).toBe(0);
    const read = client.of("opening").map(({ bytes, totalBytes }) => bytes / totalBytes);
    expect(read).toEqual([0, 0.5, 1]);
    await vi.waitFor(() => expect(client.of("measured").map((m) => m.generation)).toEqual([1]));
    expect(client.of("done").map((m) => [m.generation, m.statistics.isTreeCut])).toEqual([
      [1, false],
      [1, true],
    ]);
    expect(client.broken).toEqual([]);
  });

  test("sends few of many edits, and the last one", async () => {
    client.stream.open("ball", 0);
    client.stream.start();
    await client.done();
    const before = client.stream.framesSent;
    const start = performance.now();
    const betas = Array.from({ length: 60 }, (_, i) => (i % 3 === 0 ? 0.1 : i % 3 === 1 ? 0.01 : 0.2));
    for (const beta of [...betas, 0.5]) {
      client.stream.edit({ beta });
      await new Promise((turn) => setTimeout(turn, 2));
    }
    await vi.waitFor(() => expect(client.stream.dirty).toBe(false));
    const [sent, elapsed] = [client.stream.framesSent - before, performance.now() - start];
    await vi.waitFor(() => {
      expect(client.pipeline.settled).toBe(true);
      expect(client.scene.triangles).toBe(trianglesAt(2));
    }, 20_000);
    expect(server.received.at(-1)).toMatchObject({ type: "edit", beta: 0.5 });
    // 61 edits; at most one message in 50 ms.
    expect(sent).toBeLessThanOrEqual(Math.floor(elapsed / 50) + 1);
    expect(sent).toBeLessThan(61);
    expect(client.broken).toEqual([]);
  });

  test("reconnects when the server is back, with the user's values", async () => {
    client.stream.open("ball", 0);
    client.stream.start();
    await client.done();
    client.stream.edit({ beta: 0.5 });
    await client.done(2);
    client.stream.remember({ transferFunction: { points: [{ x: 0, importance: 1, color: "#abcdef" }] } });
    await server.close();
    await vi.waitFor(() => expect(client.states.at(-1)).toBe("waiting"));
    const triangles = client.scene.triangles;
    expect(triangles).toBe(trianglesAt(2));
    server.received.length = 0;
    await server.listen(port);
    await client.done(3);
    expect(server.received[0]).toEqual({ type: "open", volume: "ball", step: 0 });
    expect(server.received[1]).toMatchObject({
      type: "edit",
      beta: 0.5,
      transferFunction: { points: [{ color: "#abcdef" }] },
    });
    expect(client.scene.triangles).toBe(triangles);
  });

  test("another step keeps the edit, another volume brings its own", async () => {
    client.stream.open("ball-mirrored", 0);
    client.stream.start();
    await client.done();
    client.stream.edit({ beta: 0.5 });
    await client.done(2);
    client.stream.open("ball-mirrored", 3);
    await client.done(3);
    expect(client.scene.triangles).toBe(trianglesAt(2, 3));
    client.stream.open("ball", 0);
    await client.done(4);
    expect(client.of("opened").at(-1)?.edit.beta).toBe(OPENING.beta);
    expect(client.scene.triangles).toBe(trianglesAt(0));
  });

  test("acknowledges frames of the open volume only", async () => {
    client.stream.open("ball", 0);
    client.stream.start();
    await client.done();
    client.stream.acknowledge(1);
    client.stream.open("ball-mirrored", 0);
    client.stream.acknowledge(1);
    await client.done(2);
    expect(server.received.filter(({ type }) => type === "drawn")).toEqual([{ type: "drawn", generation: 1 }]);
  });

  test("refuses edits before a volume is open", () => {
    expect(client.stream.edit({ beta: 1 })).toBe(false);
  });

  test("passes on errors and continues", async () => {
    client.stream.open("nothing", 0);
    client.stream.start();
    await vi.waitFor(() => expect(client.of("error")[0]?.message).toContain("nothing"));
    client.stream.open("ball", 0);
    await client.done();
    client.stream.edit({ alpha: 7 });
    await vi.waitFor(() => expect(client.of("error")[1]?.message).toContain("alpha: 7, expected 0 to 1"));
  });
});

test("chunks dropped while they wait are never decoded", () => {
  const posted: number[] = [];
  const worker: DecodeWorker = { postMessage: ({ id }) => posted.push(id), onmessage: null, onerror: null };
  const decoded: number[] = [];
  const queue = new DecodeQueue(worker, (id) => decoded.push(id), () => undefined);
  for (let id = 1; id <= 10; id += 1) queue.push(id, new ArrayBuffer(16 << 10));
  expect(posted).toEqual([1, 2, 3, 4]);
  queue.drop([1, 5, 6, 7, 8, 9]);
  expect(posted).toEqual([1, 2, 3, 4, 10]);
  const chunk = { vertices: new Int16Array(0), indices: new Uint16Array(0) };
  for (const id of posted) worker.onmessage?.({ data: { id, chunk } } as MessageEvent<DecodeReply>);
  expect(decoded).toEqual([2, 3, 4, 10]);
  expect(queue.size).toBe(0);
});

test("small chunks are in flight together, a large one alone", () => {
  const posted: number[] = [];
  const worker: DecodeWorker = { postMessage: ({ id }) => posted.push(id), onmessage: null, onerror: null };
  const queue = new DecodeQueue(worker, () => undefined, () => undefined);
  for (let id = 1; id <= 100; id += 1) queue.push(id, new ArrayBuffer(256));
  expect(posted.length).toBe(100);
  queue.push(101, new ArrayBuffer(1 << 20));
  expect(posted.length).toBe(100);
  queue.drop(posted.slice());
  expect(posted.at(-1)).toBe(101);
  queue.push(102, new ArrayBuffer(1));
  expect(posted.length).toBe(101);
});

describe("throttle", () => {
  beforeEach(() => vi.useFakeTimers());
  afterEach(() => vi.useRealTimers());

  test("runs at once, then at most once an interval, and the last call always", () => {
    let calls = 0;
    const throttle = new Throttle(50, () => (calls += 1));
    throttle.call();
    expect(calls).toBe(1);
    for (let i = 0; i < 100; i += 1) {
      throttle.call();
      vi.advanceTimersByTime(1);
    }
    expect(calls).toBe(3);
    throttle.call();
    vi.advanceTimersByTime(50);
    expect(calls).toBe(4);
    vi.advanceTimersByTime(500);
    expect(calls).toBe(4);
  });
});

describe("server messages", () => {
  test.each(["", "[1]", "null", '{"type":"hello"}', '{"type":"prefix","generation":1}', '{"type":"measured","surface":0,"generation":1,"regions":[]}', '{"type":"opened","volume":null}', '{"type":"toString"}'])(
    "%s is refused",
    (text) => expect(() => parseServerMessage(text)).toThrow(/server message/),
  );
});
