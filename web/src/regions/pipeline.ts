/** From binary frames to the screen: header check, region map, decoding, upload, swap. */

import type { DecodedChunk } from "../decode/decode";
import { DecodeQueue, type DecodeWorker } from "../decode/queue";
import { readChunkHeader, type ChunkHeader } from "../protocol/chunk";
import { REGION_CELLS } from "../protocol/generated";
import type { RegionMeshData } from "../scene/regionMesh";
import { emptyMap, isSettled, reduce, type ChunkId, type Effects, type RegionEvent, type Swap } from "./map";

/** What the pipeline needs of the scene. */
export interface RegionScene {
  upload(id: ChunkId, data: RegionMeshData): void;
  swap(show: readonly ChunkId[], remove: readonly ChunkId[]): void;
  drop(ids: readonly ChunkId[]): void;
  clear(): void;
}

export interface PipelineHandlers {
  /** A prefix is shown. */
  readonly onSwap: (swap: Swap) => void;
  /** The server or a chunk broke the protocol: start over with a `reset` and a new connection. */
  readonly onBroken: (reason: string) => void;
}

export class RegionPipeline {
  private map = emptyMap();
  /** Of chunks that are not resident yet. */
  private readonly headers = new Map<ChunkId, ChunkHeader>();
  private readonly queue: DecodeQueue;
  private lastId: ChunkId = 0;

  constructor(
    worker: DecodeWorker,
    private readonly scene: RegionScene,
    private readonly handlers: PipelineHandlers,
  ) {
    this.queue = new DecodeQueue(
      worker,
      (id, chunk) => this.decoded(id, chunk),
      (reason) => this.handlers.onBroken(reason),
    );
  }

  /** Chunks received, but not decoded yet. */
  get undecoded(): number {
    return this.queue.size;
  }

  /** Whether everything that was announced is shown. */
  get settled(): boolean {
    return isSettled(this.map);
  }

  /** A binary frame of the open volume. */
  chunk(frame: ArrayBuffer): void {
    let header: ChunkHeader;
    try {
      header = readChunkHeader(frame);
    } catch (error) {
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
      return;
    }
    const { generation, level, region, vertexCount } = header;
    const id = vertexCount === 0 ? null : ++this.lastId;
    if (!this.event({ type: "chunk", generation, level, region: region.join(), id }) || id === null) return;
    this.headers.set(id, header);
    this.queue.push(id, frame);
  }

  /** A message about prefixes, or `reset`. `false` when it came out of order. */
  event(event: RegionEvent): boolean {
    let effects: Effects;
    try {
      effects = reduce(this.map, event);
    } catch (error) {
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
      return false;
    }
    this.queue.drop(effects.dropped);
    this.scene.drop(effects.dropped);
    for (const id of effects.dropped) this.headers.delete(id);
    for (const swap of effects.swaps) {
      this.scene.swap(swap.show, swap.remove);
      this.handlers.onSwap(swap);
    }
    return true;
  }

  /** A region mesh is on the GPU. */
  resident(id: ChunkId): void {
    this.headers.delete(id);
    this.event({ type: "resident", id });
  }

  /** Forgets the surface on screen too: for another volume, or after the GPU lost it. */
  clear(): void {
    this.event({ type: "reset" });
    this.map = emptyMap();
    this.headers.clear();
    this.scene.clear();
  }

  private decoded(id: ChunkId, chunk: DecodedChunk): void {
    const header = this.headers.get(id);
    if (header === undefined) return;
    const [a, b, c] = header.region;
    this.scene.upload(id, {
      vertices: chunk.vertices,
      indices: chunk.indices,
      levelTriangles: header.levelTriangles,
      corner: [a * REGION_CELLS, b * REGION_CELLS, c * REGION_CELLS],
      lattice: header.lattice,
      bounds: header.bounds,
    });
  }
}
