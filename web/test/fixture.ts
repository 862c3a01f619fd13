/**
 * A small server of the stream for a synthetic volume: for developing the viewer without a device, and for tests of the
 * client's network side. Cuts and histograms are made up.
 */

import { createServer, type IncomingMessage, type Server, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import type { Duplex } from "node:stream";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { WebSocket, WebSocketServer } from "ws";
import { SUBPROTOCOL } from "../src/protocol/generated";
import type { Capabilities, ClientMessage, Edit, FieldInfo, Probed, Question, ServerMessage, Statistics, View, VolumeInfo, VolumeSummary } from "../src/protocol/types";
import { complete } from "../src/protocol/view";
import { CELLS, encodeChunk, encodeDistances, feature, surfaceNets, wobblyBall, type Field, type SyntheticMesh } from "./synthetic";

function describe(name: string, unit: string | null, field: Field): FieldInfo {
  const samples: number[] = [];
  for (let z = 0; z <= CELLS; z += 2)
    for (let y = 0; y <= CELLS; y += 2) for (let x = 0; x <= CELLS; x += 2) samples.push(field(x, y, z));
  const [min, max] = [samples.reduce((a, b) => Math.min(a, b)), samples.reduce((a, b) => Math.max(a, b))];
  const counts = new Array<number>(256).fill(0);
  for (const value of samples) counts[Math.min(255, Math.floor((256 * (value - min)) / (max - min)))]! += 1;
  const openingIso = { iso: (min + max) / 2, reason: "whole-histogram", explanation: "between two classes of values" } as const;
  return { name, type: "f32", unit, range: [min, max], histogram: { min, max, counts }, openingIso, derivedFeatures: {} };
}

function volume(id: string, title: string, steps: number, mirrored: boolean): VolumeInfo {
  // Not the fields' true gradients; the tests only need them to differ.
  const gradient = (offset: number) =>
    describe("gradient-magnitude", "mm per world unit", (x, y, z) => wobblyBall(0)(x, y, z) / 60 + offset);
  const fields = [
    { ...describe("depth", "mm", wobblyBall(0)), derivedFeatures: { "gradient-magnitude": gradient(1), "mean-curvature": { unit: "per world unit" } } },
    { ...describe("height", null, feature), derivedFeatures: { "gradient-magnitude": gradient(2) } },
  ];
  return {
    id,
    title,
    geometry: {
      dims: [CELLS + 1, CELLS + 1, CELLS + 1],
      spacing: [1, 1, 1.1],
      origin: [-32, -32, -35],
      direction: [[mirrored ? -1 : 1, 0, 0], [0, 1, 0], [0, 0, 1]],
      frame: "world",
      unit: null,
    },
    steps,
    step: 0,
    times: null,
    fields,
    features: [gradient(1), ...fields.map((field) => ({ ...field, derivedFeatures: {} }))],
    vectors: [],
    notice: mirrored ? null : "Synthetic data of isopeel's tests.\n\nNo rights reserved. " + "It was made up on the spot. ".repeat(12),
    opening: null,
  };
}

export const VOLUMES: readonly VolumeInfo[] = [
  volume("ball", "Wobbly ball", 1, false),
  volume("ball-mirrored", "Growing ball, mirrored", 6, true),
];

export const OPENING: View = {
  iso: 0,
  field: "depth",
  mask: null,
  feature: "height",
  featureRange: [0, 1],
  colorField: null,
  alpha: 0.6,
  beta: undefined,
  error: "1px",
  triangles: { share: 0.25, max: 1_000_000 },
  bytes: undefined,
  minPart: 0,
  parts: null,
  maxError: "auto",
  topology: "auto",
  mesher: "dual",
  detail: "view",
  cap: false,
  maxLevel: 5,
  transferFunction: {
    points: [
      { x: 0, importance: 0.02, color: "#2f5d8c" },
      { x: 0.35, importance: 0.12, color: "#5fa8a0" },
      { x: 0.62, importance: 0.7, color: "#e8c66a" },
      { x: 1, importance: 1, color: "#d9572b" },
    ],
  },
  interest: [],
};

/** The finest cells a β leaves, so that a change of β changes the mesh. */
const finestLevel = (beta = 0.02) => (beta < 0.05 ? 0 : beta < 0.3 ? 1 : 2);

export const CAPABILITIES: Capabilities = { surfaces: 4, chunkKinds: ["cut", "error"], measuredError: true, steps: false, watches: false, groups: false, questions: ["probe", "distribution", "curve", "annotate"] };

interface OpenVolume {
  readonly volume: VolumeInfo;
  /** Surfaces follow it. */
  step: number;
}

/** From the full surface to the coarsest. */
export const CURVE = [4000, 2000, 1000, 500, 250].map((triangles, i) => ({ triangles, rms: i === 0 ? 0 : 0.025 * 2 ** i, threshold: 0.05 * 2 ** i }));

class Viewer {
  private open: OpenVolume | undefined;
  private surfaces = new Map<number, Surface>();
  private generation = 0;

  constructor(
    private readonly socket: WebSocket,
    private readonly server: FixtureServer,
  ) {
    socket.on("message", (data, binary) => {
      if (binary) return socket.close(1003);
      this.receive(JSON.parse((data as Buffer).toString("utf8")) as ClientMessage);
    });
    socket.on("close", () => {
      for (const surface of this.surfaces.values()) surface.end();
    });
  }

  get paceMs(): number {
    return this.server.paceMs;
  }

  send(message: ServerMessage): void {
    this.socket.send(JSON.stringify(message));
  }

  sendChunk(chunk: Uint8Array): void {
    this.socket.send(chunk);
  }

  /** Numbers ascend over the connection. */
  nextGeneration(): number {
    return ++this.generation;
  }

  private receive(message: ClientMessage): void {
    // Every client asks for it before all else.
    if (message.type === "heartbeat") return this.server.onHeartbeat(this);
    this.server.received.push(message);
    switch (message.type) {
      case "open": {
        const found = VOLUMES.find((v) => v.id === message.volume);
        this.stop();
        this.surfaces.clear();
        if (found === undefined) {
          const text = `no volume ${JSON.stringify(message.volume)}`;
          return this.send({ type: "error", code: "unknown-volume", message: text, open: true });
        }
        this.open = { volume: found, step: message.step };
        const totalBytes = 4 * (CELLS + 1) ** 3;
        for (const bytes of [0, totalBytes / 2, totalBytes]) this.send({ type: "opening", bytes, totalBytes });
        return this.send({
          type: "opened",
          volume: { ...found, step: message.step },
          step: message.step,
          edit: OPENING,
          device: "Fixture (no device)",
          capabilities: { ...CAPABILITIES, steps: this.server.steps },
        });
      }
      case "step": {
        const { open } = this;
        if (open === undefined) return this.send({ type: "error", code: "not-open", message: "no volume is open", open: true });
        this.stop();
        open.step = message.step;
        this.send({ type: "stepped", step: message.step, label: `t = ${message.step}` });
        for (const surface of this.surfaces.values()) surface.change({});
        return this.send({ type: "described", step: message.step, volume: { ...open.volume, step: message.step } });
      }
      case "edit": {
        const { open } = this;
        if (open === undefined) {
          return this.send({ type: "error", code: "not-open", message: "no volume is open", open: true });
        }
        const { type: _, surface: number = 0, ...change } = message as { type: string; surface?: number } & Edit;
        if (this.server.onlyLooks && Object.keys(change).length > 0) {
          return this.send({ type: "error", code: "forbidden", message: "this token is for view, expected one for edit", open: true });
        }
        if (change.alpha !== undefined && !(change.alpha >= 0 && change.alpha <= 1)) {
          return this.send({
            type: "error",
            code: "bad-edit",
            message: `alpha: ${change.alpha}, expected 0 to 1`,
            open: true,
          });
        }
        const surface = this.surfaces.get(number) ?? new Surface(this, number, open);
        this.surfaces.set(number, surface);
        return surface.change(change);
      }
      case "cancel":
        return this.stop();
      case "remove":
        this.surfaces.get(message.surface)?.stop();
        this.surfaces.delete(message.surface);
        return this.send({ type: "removed", surface: message.surface });
      case "drawn":
      case "camera":
        return;
      case "probe":
      case "distribution":
      case "curve":
        return this.send(this.answer(message));
      case "annotate":
        return this.surfaces.get(message.surface)?.annotate();
      // There are none here.
      case "lead":
      case "join":
      case "leave":
      case "pose":
      case "ask-control":
      case "give-control":
        return;
    }
  }

  /** Made up, and of the surface that is shown. */
  private answer(question: Exclude<Question, { type: "annotate" }>): ServerMessage {
    const of = { surface: question.surface, generation: this.generation };
    switch (question.type) {
      case "probe": {
        return { type: "probed", ...of, position: question.position, inside: true, values: [{ field: "depth", value: 1.5 }], nearest: this.server.nearest };
      }
      case "distribution": {
        const bins = Array.from({ length: question.bins }, (_, bin) => 1000 - bin);
        return { type: "distribution", ...of, kind: "tree", bins, coarse: bins.map((n, bin) => (3 * bin < bins.length ? n : 0)), coarseShare: 0.4 };
      }
      case "curve":
        return { type: "curve", ...of, kind: "tree", byError: true, points: CURVE };
    }
  }

  private stop(): void {
    for (const surface of this.surfaces.values()) surface.stop();
  }
}

class Surface {
  private edit = OPENING;
  private generation = 0;
  /** Fingerprint of what the client holds in each region. */
  private held = new Map<string, string>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** Until a better surface is sent and measured, unless another edit comes. */
  private rest: ReturnType<typeof setTimeout> | undefined;
  private meshes: readonly SyntheticMesh[] = [];
  private isAnnotationWanted = false;
  private isAtRest = false;

  constructor(
    private readonly viewer: Viewer,
    private readonly number: number,
    private readonly open: OpenVolume,
  ) {}

  change(edit: Edit): void {
    this.edit = { ...this.edit, ...complete(edit) };
    this.stop();
    this.run();
  }

  end(): void {
    clearTimeout(this.timer);
    clearTimeout(this.rest);
  }

  /** At rest, each vertex' distance; an edit before that drops the question. */
  annotate(): void {
    this.isAnnotationWanted = !this.isAtRest;
    if (this.isAtRest) this.sendDistances();
  }

  stop(): void {
    clearTimeout(this.rest);
    this.isAnnotationWanted = false;
    this.isAtRest = false;
    if (this.timer === undefined) return;
    clearTimeout(this.timer);
    this.timer = undefined;
    this.viewer.send({ type: "superseded", surface: this.number, generation: this.generation });
  }

  private run(): void {
    this.generation = this.viewer.nextGeneration();
    const finest = finestLevel(this.edit.beta);
    const levels = [5, 4, 3, 2, 1, 0].filter((level) => level <= Math.min(4, this.edit.maxLevel));
    const field = wobblyBall(this.open.step);
    const next = () => {
      this.timer = undefined;
      const level = levels.shift();
      if (level === undefined) return;
      const meshes = surfaceNets(field, this.edit.iso, Math.max(level, finest));
      this.prefix(level, meshes);
      if (level > 0) {
        this.timer = setTimeout(next, this.viewer.paceMs);
        return;
      }
      const triangles = meshes.reduce((sum, m) => sum + m.indices.length / 3, 0);
      const { generation } = this;
      this.viewer.send({ type: "done", trace: "00000000000000ab", surface: this.number, generation, statistics: { ...statistics(triangles), isTreeCut: false } });
      this.rest = setTimeout(() => {
        if (this.edit.beta === undefined) {
          this.prefix(0, meshes);
          this.viewer.send({ type: "done", trace: "00000000000000ab", surface: this.number, generation, statistics: statistics(triangles) });
        }
        this.viewer.send({ type: "measured", surface: this.number, generation, error: { rms: 0.04, max: 0.3 }, regions: [] });
        this.isAtRest = true;
        if (this.isAnnotationWanted) this.sendDistances();
      }, this.viewer.paceMs);
    };
    next();
  }

  private prefix(level: number, meshes: readonly SyntheticMesh[]): void {
    const { generation } = this;
    const chunks: Uint8Array[] = [];
    const now = new Map<string, string>();
    for (const mesh of meshes) {
      const key = mesh.region.join();
      // Everything but generation and prefix level, which an unchanged region keeps.
      const fingerprint = Buffer.from(encodeChunk(mesh, 0, 0)).toString("base64");
      now.set(key, fingerprint);
      if (this.held.get(key) !== fingerprint) chunks.push(encodeChunk(mesh, generation, level, this.number));
    }
    for (const key of this.held.keys()) {
      if (now.has(key)) continue;
      const region = key.split(",").map(Number) as [number, number, number];
      const none = { region, positions: [], normals: [], s: [], f: [], indices: [], levelTriangles: [0, 0, 0, 0, 0, 0] };
      chunks.push(encodeChunk(none, generation, level, this.number));
    }
    const triangles = meshes.reduce((sum, mesh) => sum + mesh.indices.length / 3, 0);
    const unchanged = [...now].filter(([key, fingerprint]) => this.held.get(key) === fingerprint).length;
    const of = { surface: this.number, generation, level, final: level === 0 };
    this.viewer.send({ type: "prefix", ...of, kind: "cut", mesher: "dual", regions: chunks.length, unchanged, triangles });
    for (const chunk of chunks) this.viewer.sendChunk(chunk);
    this.viewer.send({ type: "committed", ...of });
    this.held = now;
    this.meshes = meshes;
  }

  private sendDistances(): void {
    const of = { surface: this.number, generation: this.generation };
    this.viewer.send({ type: "annotated", ...of, annotation: "error", regions: this.meshes.length });
    for (const mesh of this.meshes) this.viewer.sendChunk(encodeDistances(mesh, distances(mesh), this.generation, this.number));
  }
}

/** Made up: it grows along the first axis, so that a vertex tells its own. */
function distances({ positions }: SyntheticMesh): number[] {
  return Array.from({ length: positions.length / 3 }, (_, vertex) => (positions[3 * vertex] ?? 0) / CELLS);
}

export function statistics(triangles: number): Statistics {
  return {
    mesher: "dual",
    beta: null,
    tolerance: 0.1,
    maxError: null,
    topology: "preserve",
    featureRange: null,
    gaveWay: [],
    isTreeCut: true,
    error: null,
    estimatedError: { rms: 0.05, worstLeaf: 0.2 },
    pixels: null,
    fullTriangles: 4 * triangles,
    mesherTriangles: null,
    removedParts: null,
    removedTriangles: null,
    unmatchedPositions: null,
    vanishedParts: 0,
    activeCells: 2 * triangles,
    leaves: [0, 0, 0, 0, 0, 0],
    triangles,
    vertices: Math.round(triangles / 2),
    lostCubes: 0,
    unpatchedVertices: 0,
    stagesMs: { classify: 1.25, march: 2.5 },
    wallMs: 12.5,
    deviceBytes: 20 * triangles,
    volumeBytes: 4 * 65 ** 3,
    device: "Fixture (no device)",
  };
}

export class FixtureServer {
  /** What every probe finds. */
  nearest: Probed["nearest"] = { distance: 0.2, smoothness: 0.5, feature: 3, blended: 0.4, importance: 0.3, leaf: { kind: "tree", level: 2, error: 0.05 }, part: 3, partArea: 120 };
  /** All messages of clients, in order. */
  readonly received: ClientMessage[] = [];
  /** Queries of the addresses at which streams were opened, in order. */
  readonly queries: string[] = [];
  /** A client asks for signs of life. */
  onHeartbeat: (connection: { send: (message: ServerMessage) => void }) => void = () => undefined;
  /** `step` is understood. */
  steps = false;
  /** Refuses edits that change something, as for a user who may only look. */
  onlyLooks = false;
  /** Pause between prefixes, milliseconds. */
  paceMs = 15;
  private readonly sockets = new WebSocketServer({
    noServer: true,
    handleProtocols: (offered) => (offered.has(SUBPROTOCOL) ? SUBPROTOCOL : false),
  });
  private server: Server | undefined;

  /** Responds to a REST request; `false` when it is none. */
  respond(request: IncomingMessage, response: ServerResponse): boolean {
    if (request.url !== "/api/v1/volumes") return false;
    const list: VolumeSummary[] = VOLUMES.map(({ id, title, geometry, steps, fields, notice }) => ({
      id,
      title,
      dims: geometry.dims,
      steps,
      fields: fields.map((f) => f.name),
      notice,
      jobServer: null,
    }));
    response.setHeader("content-type", "application/json");
    response.end(JSON.stringify(list));
    return true;
  }

  /** Upgrades a connection to the stream. */
  upgrade(request: IncomingMessage, socket: Duplex, head: Buffer): void {
    const { pathname, search } = new URL(request.url ?? "", "http://localhost");
    if (pathname !== "/api/v1/stream") return;
    this.queries.push(search);
    this.sockets.handleUpgrade(request, socket, head, (ws) => {
      // The encoder is WebAssembly, compiled once.
      void MeshoptEncoder.ready.then(() => new Viewer(ws, this));
    });
  }

  /** Listens on a port of its own; returns it. */
  async listen(port = 0): Promise<number> {
    await MeshoptEncoder.ready;
    const server = createServer((request, response) => {
      if (this.respond(request, response)) return;
      response.statusCode = 404;
      response.end();
    });
    server.on("upgrade", (request, socket, head) => this.upgrade(request, socket, head));
    await new Promise<void>((done) => server.listen(port, "127.0.0.1", done));
    this.server = server;
    return (server.address() as AddressInfo).port;
  }

  async close(): Promise<void> {
    for (const socket of this.sockets.clients) socket.terminate();
    const { server } = this;
    this.server = undefined;
    await new Promise((done) => (server === undefined ? done(undefined) : server.close(done)));
  }
}

/** Lengths of a volume without a unit. */
export const voxels = (spacing: number) => ({ spacing, unit: undefined });
