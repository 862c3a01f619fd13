import { MeshoptDecoder } from "meshoptimizer/decoder";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { WebSocket } from "ws";
import { DecodeService, type DecodeReply, type DecodeRequest } from "../src/decode/service";
import type { RegionMeshData } from "../src/scene/regionMesh";
import type { DecodeWorker } from "../src/decode/queue";
import { DecodeQueue } from "../src/decode/queue";
import { Connection } from "../src/net/connection";
import { Throttle } from "../src/net/throttle";
import { parseServerMessage } from "../src/protocol/messages";
import type { ServerMessage } from "../src/protocol/types";
import type { Annotation } from "../src/regions/annotations";
import { RegionPipeline, type RegionScene } from "../src/regions/pipeline";
import { ActingPage } from "./acting";
import { FixtureServer, OPENING } from "./fixture";
import { CELLS, encodeChunk, encodeDistances, surfaceNets, wobblyBall, type SyntheticMesh } from "./synthetic";

/** Does what the worker does, in this thread. */
class LocalWorker implements DecodeWorker {
  onmessage: DecodeWorker["onmessage"] = null;
  onerror: DecodeWorker["onerror"] = null;
  readonly requests: number[] = [];
  readonly service = new DecodeService(MeshoptDecoder, (data) => this.onmessage?.({ data } as MessageEvent<DecodeReply>));
  postMessage(request: DecodeRequest): void {
    if (request.type === "decode") this.requests.push(request.id);
    this.service.receive(request);
  }
}

/** A scene without WebGL: what is uploaded is resident in the next task. */
class PlainScene implements RegionScene {
  readonly ready = new Map<number, number>();
  readonly shown = new Map<number, number>();
  onResident: (id: number) => void = () => undefined;
  /** All that was uploaded. */
  readonly meshes = new Map<number, RegionMeshData>();
  /** How long an upload takes. */
  uploadMs = 0;
  upload(id: number, data: RegionMeshData): void {
    this.meshes.set(id, data);
    setTimeout(() => {
      this.ready.set(id, data.indices.length / 3);
      this.onResident(id);
    }, this.uploadMs);
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
  /** Of each mesh on screen. */
  readonly values = new Map<number, Float32Array>();
  setValues(id: number, values: Float32Array): void {
    expect(this.shown.has(id)).toBe(true);
    const vertices = (this.meshes.get(id)?.vertices.length ?? 0) / 6;
    if (values.length !== vertices) throw new Error(`${values.length} values, expected ${vertices}`);
    this.values.set(id, values);
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
  readonly annotations: Annotation[] = [];
  readonly scene = new PlainScene();
  readonly worker = new LocalWorker();
  readonly pipeline: RegionPipeline;
  readonly page: ActingPage;
  readonly looks: string[] = [];
  onOpened: () => void = () => undefined;

  constructor(port: number) {
    this.pipeline = new RegionPipeline(this.worker, this.scene, {
      onSwap: () => undefined,
      onAnnotated: (annotation) => this.annotations.push(annotation),
      onBroken: (reason) => this.broken.push(reason),
    });
    this.scene.onResident = (id) => this.pipeline.resident(id);
    this.page = new ActingPage(`ws://127.0.0.1:${port}/api/v1/stream`, {
      onState: (state) => this.states.push(state),
      onReset: () => void this.pipeline.event({ type: "reset" }),
      onChunk: (frame) => this.pipeline.chunk(frame),
      onBroken: (reason) => this.broken.push(reason),
      onOnlyLooks: (reason) => this.looks.push(reason),
      onMessage: (message) => {
        this.messages.push(message);
        if (message.type === "opened") this.onOpened();
        const { type } = message;
        if (type === "prefix" || type === "committed" || type === "superseded" || type === "removed") {
          this.pipeline.event(message);
        }
        if (type === "annotated") this.pipeline.annotated(message);
      },
    });
  }

  get stream() {
    return this.page.client;
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
    client.page.open("ball", 0);
    client.stream.start();
    await client.done();
    expect(server.received).toEqual([{ type: "open", volume: "ball", step: 0, codings: ["predictive", "values"] }, { type: "edit" }]);
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
    client.page.open("ball", 0);
    client.stream.start();
    await client.done();
    const before = client.stream.framesSent;
    const start = performance.now();
    const betas = Array.from({ length: 60 }, (_, i) => (i % 3 === 0 ? 0.1 : i % 3 === 1 ? 0.01 : 0.2));
    for (const beta of [...betas, 0.5]) {
      client.page.edit({ beta });
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
    // The worker keeps what is shown alone, and knows all of it.
    expect(client.worker.service.size).toBe(client.scene.shown.size);
    const { area, borderEdges } = await client.pipeline.sum(0, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    expect(borderEdges).toBe(0);
    expect(area).toBeGreaterThan(4 * Math.PI * 20 ** 2);
  });

  test("reconnects when the server is back, with the user's values", async () => {
    client.page.open("ball", 0);
    client.stream.start();
    await client.done();
    client.page.edit({ beta: 0.5 });
    await client.done(2);
    client.page.edit({ transferFunction: { points: OPENING.transferFunction.points.map((point) => ({ ...point, color: "#abcdef" })) } });
    await server.close();
    await vi.waitFor(() => expect(client.states.at(-1)).toBe("waiting"));
    const triangles = client.scene.triangles;
    expect(triangles).toBe(trianglesAt(2));
    server.received.length = 0;
    await server.listen(port);
    await client.done(3);
    expect(server.received[0]).toEqual({ type: "open", volume: "ball", step: 0, codings: ["predictive", "values"] });
    expect(server.received[1]).toMatchObject({
      type: "edit",
      beta: 0.5,
      transferFunction: { points: OPENING.transferFunction.points.map(() => ({ color: "#abcdef" })) },
    });
    expect(client.scene.triangles).toBe(triangles);
  });

  test("connects anew before the server has opened anything", async () => {
    const count = (state: string) => client.states.filter((one) => one === state).length;
    client.stream.start();
    await vi.waitFor(() => expect(count("connected")).toBe(1));
    // A volume may take longer to open than the token lives that the socket has.
    client.stream.reconnect();
    await vi.waitFor(() => expect(count("connected")).toBe(2));
    client.page.open("ball", 0);
    await client.done();
  });

  test("another step keeps the edit, another volume brings its own", async () => {
    client.page.open("ball-mirrored", 0);
    client.stream.start();
    await client.done();
    client.page.edit({ beta: 0.5 });
    await client.done(2);
    client.page.open("ball-mirrored", 3);
    await client.done(3);
    expect(client.scene.triangles).toBe(trianglesAt(2, 3));
    client.page.open("ball", 0);
    await client.done(4);
    expect(client.of("opened").at(-1)?.edit.beta).toBe(OPENING.beta);
    expect(client.scene.triangles).toBe(trianglesAt(0));
  });

  test("goes to another step without opening the volume again, where the server can", async () => {
    server.steps = true;
    client.page.open("ball-mirrored", 0);
    client.stream.start();
    await client.done();
    client.page.edit({ beta: 0.5 });
    await client.done(2);
    client.page.open("ball-mirrored", 3);
    client.page.open("ball-mirrored", 2);
    await vi.waitFor(() => expect(client.scene.triangles).toBe(trianglesAt(2, 2)));
    expect(server.received.filter(({ type }) => type === "open" || type === "step")).toEqual([
      { type: "open", volume: "ball-mirrored", step: 0, codings: ["predictive", "values"] },
      { type: "step", step: 3 },
      { type: "step", step: 2 },
    ]);
    // The reply to the first one came too late to count.
    expect([client.of("stepped").map(({ step }) => step), client.of("described").map(({ step }) => step)]).toEqual([[2], [2]]);
    expect(client.broken).toEqual([]);
    // A new connection opens the step that was asked for last, with the edits.
    client.stream.restart();
    await vi.waitFor(() => expect(client.of("opened")).toHaveLength(2));
    expect(client.of("opened")[1]).toMatchObject({ step: 2 });
    expect(client.page.store.view?.beta).toBe(0.5);
    await vi.waitFor(() => expect(server.received.at(-1)).toMatchObject({ type: "edit", beta: 0.5 }));
  });

  test("acknowledges frames of the open volume only", async () => {
    client.page.open("ball", 0);
    client.stream.start();
    await client.done();
    client.stream.acknowledge(1);
    client.page.open("ball-mirrored", 0);
    client.stream.acknowledge(1);
    await client.done(2);
    expect(server.received.filter(({ type }) => type === "drawn")).toEqual([{ type: "drawn", generation: 1 }]);
  });

  test("connects anew and says why where signs of life stay away", async () => {
    const reasons: (string | undefined)[] = [];
    server.onHeartbeat = (connection) => connection.send({ type: "heartbeat", seconds: 0.2 });
    const stream = new Connection(() => `ws://127.0.0.1:${port}/api/v1/stream`, {
      onOpen: () => stream.send(JSON.stringify({ type: "heartbeat" })),
      onText: () => stream.expectWithin(0.2),
      onBinary: () => undefined,
      onState: (state, reason) => state === "waiting" && reasons.push(reason),
    });
    stream.start();
    await vi.waitFor(() => expect(reasons).toEqual(["nothing has come from the server for 1 s"]), 4000);
    stream.stop();
  });

  test("edits, removes and repeats surfaces, each with a map of its own", async () => {
    client.page.open("ball", 0);
    client.stream.start();
    await client.done();
    client.page.change((store) => {
      store.addSurface(6);
      store.edit({ triangles: 1000 });
    });
    const both = trianglesAt(0) + trianglesAt(0, 0, 6);
    await vi.waitFor(() => expect(client.scene.triangles).toBe(both), 20_000);
    expect(server.received.at(-1)).toMatchObject({ type: "edit", surface: 1, iso: 6, triangles: 1000 });
    await vi.waitFor(() => expect(client.of("measured").map((m) => m.surface)).toContain(1), 20_000);

    server.received.length = 0;
    await server.close();
    await vi.waitFor(() => expect(client.states.at(-1)).toBe("waiting"), 20_000);
    await server.listen(port);
    await vi.waitFor(() => expect(server.received).toHaveLength(3), 20_000);
    expect(server.received[1]).toEqual({ type: "edit", triangles: 1000, error: OPENING.error });
    expect(server.received[2]).toMatchObject({ type: "edit", surface: 1, iso: 6, triangles: 1000 });
    await vi.waitFor(() => expect(client.of("measured")).toHaveLength(4), 20_000);
    await vi.waitFor(() => expect(client.scene.triangles).toBe(both), 20_000);

    client.page.change((store) => store.removeSurface(1));
    await vi.waitFor(() => expect(client.of("removed")).toEqual([{ type: "removed", surface: 1 }]), 20_000);
    expect(client.scene.triangles).toBe(trianglesAt(0));
    expect(client.broken).toEqual([]);
  }, 60_000);

  test.each([0, 120])("gives each vertex its own distance, where meshes take %d ms to be on screen", async (uploadMs) => {
    client.scene.uploadMs = uploadMs;
    client.page.open("ball", 0);
    client.stream.start();
    // Asked at once: the answer follows the chunks closely.
    await vi.waitFor(() => expect(client.of("done")).not.toEqual([]), 20_000);
    client.stream.ask({ type: "annotate", surface: 0, annotation: "error" });
    await vi.waitFor(() => expect(client.annotations).toHaveLength(1), 20_000);
    const { shown, meshes, values } = client.scene;
    expect(client.annotations[0]).toMatchObject({ surface: 0, generation: 1 });
    expect(client.annotations[0]?.values).toHaveLength(shown.size);
    expect([...values.keys()].sort()).toEqual([...shown.keys()].sort());
    let vertices = 0;
    for (const [id, distances] of values) {
      const { vertices: words, corner, lattice } = meshes.get(id)!;
      expect(distances).toHaveLength(words.length / 6);
      // The fixture's distances grow along the first axis, so the decoded position says which one each vertex must have.
      distances.forEach((distance, v) => {
        vertices += 1;
        expect(Math.abs(distance - (corner[0] + words[6 * v]! / lattice) / CELLS)).toBeLessThan(1e-4);
      });
    }
    expect(vertices).toBeGreaterThan(1000);
    expect(client.broken).toEqual([]);
  });

  test("passes on errors and continues", async () => {
    client.page.open("nothing", 0);
    client.stream.start();
    await vi.waitFor(() => expect(client.of("error")[0]?.message).toContain("nothing"));
    client.page.open("ball", 0);
    await client.done();
    client.page.edit({ alpha: 7 });
    await vi.waitFor(() => expect(client.of("error")[1]?.message).toContain("alpha: 7, expected 0 to 1"));
  });
});

test.each(["before", "after"])("values that are not as many as a mesh has vertices end the connection, %s the mesh is on screen", async (when) => {
  await Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]);
  const [mesh] = surfaceNets(wobblyBall(0), 0, 2);
  const [scene, broken] = [new PlainScene(), [] as string[]];
  const pipeline = new RegionPipeline(new LocalWorker(), scene, { onSwap: () => undefined, onAnnotated: () => undefined, onBroken: (reason) => broken.push(reason) });
  scene.onResident = (id) => pipeline.resident(id);
  const of = { surface: 0, generation: 1, level: 0, final: true } as const;
  pipeline.event({ type: "prefix", ...of, mesher: "dual", regions: 1 });
  pipeline.chunk(encodeChunk(mesh!, 1, 0).buffer);
  pipeline.event({ type: "committed", ...of });
  const few = { ...mesh!, positions: mesh!.positions.slice(3), normals: mesh!.normals.slice(3), s: mesh!.s.slice(1), f: mesh!.f.slice(1) };
  const annotate = () => {
    pipeline.annotated({ type: "annotated", surface: 0, generation: 1, annotation: "error", regions: 1 });
    pipeline.chunk(encodeDistances(few, few.s, 1).buffer);
  };
  if (when === "before") annotate();
  await vi.waitFor(() => expect(scene.shown.size).toBe(1));
  if (when === "after") annotate();
  expect(broken).toEqual([`${few.s.length} values, expected ${mesh!.s.length}`]);
});

test("a larger region takes the place of smaller ones, and gets the values of its vertices", async () => {
  await Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]);
  const [scene, broken] = [new PlainScene(), [] as string[]];
  const pipeline = new RegionPipeline(new LocalWorker(), scene, { onSwap: () => undefined, onAnnotated: () => undefined, onBroken: (reason) => broken.push(reason) });
  scene.onResident = (id) => pipeline.resident(id);
  const small = surfaceNets(wobblyBall(0), 0, 2);
  const gone = small.map((mesh) => ({ ...mesh, positions: [], normals: [], s: [], f: [], indices: [], levelTriangles: [0, 0, 0, 0, 0, 0] }));
  const large = { ...small[0]!, region: [0, 0, 0] as const, size: 1 };
  expect(small[0]!.region).toEqual([0, 0, 0]);
  const send = (meshes: readonly SyntheticMesh[], generation: number) => {
    const of = { surface: 0, generation, level: 0, final: true } as const;
    pipeline.event({ type: "prefix", ...of, mesher: "dual", regions: meshes.length });
    for (const mesh of meshes) pipeline.chunk(encodeChunk(mesh, generation, 0).buffer);
    pipeline.event({ type: "committed", ...of });
  };
  send(small, 1);
  send([large, ...gone], 2);
  await vi.waitFor(() => expect([...scene.shown.keys()]).toEqual([small.length + 1]));
  expect([...scene.meshes.values()].at(-1)).toMatchObject({ corner: [0, 0, 0] });
  pipeline.annotated({ type: "annotated", surface: 0, generation: 2, annotation: "error", regions: 1 });
  pipeline.chunk(encodeDistances(large, large.s, 2).buffer);
  expect([...scene.values.keys()]).toEqual([small.length + 1]);
  expect(broken).toEqual([]);
});

test("meshes are of the mesher that their own prefix names", async () => {
  await Promise.all([MeshoptEncoder.ready, MeshoptDecoder.ready]);
  const [mesh] = surfaceNets(wobblyBall(0), 0, 2);
  const [scene, broken] = [new PlainScene(), [] as string[]];
  const pipeline = new RegionPipeline(new LocalWorker(), scene, { onSwap: () => undefined, onAnnotated: () => undefined, onBroken: (reason) => broken.push(reason) });
  scene.onResident = (id) => pipeline.resident(id);
  // All are announced before the first is decoded.
  for (const [surface, generation, level, mesher] of [[0, 1, 2, "dual"], [1, 2, 0, "dual"], [0, 3, 0, "marching-cubes"]] as const) {
    const of = { surface, generation, level, final: level === 0 };
    pipeline.event({ type: "prefix", ...of, mesher, regions: 1 });
    pipeline.chunk(encodeChunk(mesh!, generation, level, surface).buffer);
    pipeline.event({ type: "committed", ...of });
  }
  await vi.waitFor(() => expect(scene.meshes.size).toBe(3));
  expect([...scene.meshes.values()].map(({ surface, mesher }) => [surface, mesher])).toEqual([[0, "dual"], [1, "dual"], [0, "marching-cubes"]]);
  expect(broken).toEqual([]);
});

test("chunks dropped while they wait are never decoded", () => {
  const posted: number[] = [];
  const worker: DecodeWorker = { postMessage: (request) => request.type === "decode" && posted.push(request.id), onmessage: null, onerror: null };
  const decoded: number[] = [];
  const queue = new DecodeQueue(worker, (id) => decoded.push(id), () => undefined);
  for (let id = 1; id <= 10; id += 1) queue.push(id, new ArrayBuffer(16 << 10));
  expect(posted).toEqual([1, 2, 3, 4]);
  queue.drop([1, 5, 6, 7, 8, 9]);
  expect(posted).toEqual([1, 2, 3, 4, 10]);
  const chunk = { vertices: new Int16Array(0), indices: new Uint16Array(0) };
  for (const id of posted) worker.onmessage?.({ data: { type: "decoded", id, chunk } } as MessageEvent<DecodeReply>);
  expect(decoded).toEqual([2, 3, 4, 10]);
  expect(queue.size).toBe(0);
});

test("small chunks are in flight together, a large one alone", () => {
  const posted: number[] = [];
  const worker: DecodeWorker = { postMessage: (request) => request.type === "decode" && posted.push(request.id), onmessage: null, onerror: null };
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

describe("a user who may only look", () => {
  test("is shown what the volume opens with, though the page wants another surface", async () => {
    server.onlyLooks = true;
    // As of a link, whose values are a part of the first edit.
    client.onOpened = () => client.page.edit({ iso: 0.1 });
    client.stream.start();
    client.page.open("ball", 0);
    await client.done();
    expect(client.looks).toEqual(["this token is for view, expected one for edit"]);
    expect(client.of("error")).toEqual([]);
    expect(server.received.slice(1)).toEqual([{ type: "edit", iso: 0.1 }, { type: "edit" }]);
    client.page.edit({ iso: 0.3 });
    await vi.waitFor(() => expect(client.of("error")).toHaveLength(1));
    expect(server.received.at(-1), "what is shown is shown still").toMatchObject({ type: "edit", iso: 0.3 });
  });
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
