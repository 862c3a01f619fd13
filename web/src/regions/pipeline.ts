/**
 * From binary frames to the picture: header check, region map, decoding, upload, swap. The one place where protocol,
 * decoder, region map and scene meet.
 */

import { emptyRegions, isSettled, reduce, type Effects, type RegionEvent, type Swap, type ChunkId } from "./map";
import type { DecodedChunk } from "../decode/decode";
import { DecodeQueue, type DecodeWorker } from "../decode/queue";
import { readChunkHeader, type ChunkHeader } from "../protocol/chunk";
import { REGION_CELLS } from "../protocol/types";
import type { RegionMeshData } from "../scene/regionMesh";

/** What the pipeline needs of the scene. */
export interface RegionScene {
  upload(id: number, data: RegionMeshData): void;
  swap(show: readonly number[], remove: readonly number[]): void;
  drop(ids: readonly number[]): void;
  clear(): void;
}

export class RegionPipeline {
  private regions = emptyRegions();
  private readonly headers = new Map<ChunkId, ChunkHeader>();
  private readonly queue: DecodeQueue;
  private lastId = 0;

  /**
   * `onSwap` hears of each prefix when it is shown; `onBroken` when the server or a chunk broke the protocol: the session
   * then has to start over, with `reset`.
   */
  constructor(
    worker: DecodeWorker,
    private readonly scene: RegionScene,
    private readonly onSwap: (swap: Swap) => void,
    private readonly onBroken: (reason: string) => void,
  ) {
    this.queue = new DecodeQueue(
      worker,
      (id, chunk) => this.decoded(id, chunk),
      (_, reason) => this.onBroken(reason),
    );
  }

  /** Chunks received, but not decoded yet. */
  get undecoded(): number {
    return this.queue.size;
  }

  /** Whether everything that was announced is shown. */
  get settled(): boolean {
    return isSettled(this.regions);
  }

  /** A binary frame of the open session. */
  chunk(frame: ArrayBuffer): void {
    let header: ChunkHeader;
    try {
      header = readChunkHeader(frame);
    } catch (error) {
      this.onBroken(error instanceof Error ? error.message : String(error));
      return;
    }
    const { generation, level, region, vertexCount } = header;
    const id = vertexCount === 0 ? null : ++this.lastId;
    if (!this.event({ type: "chunk", generation, level, region: region.join(), id }) || id === null) return;
    this.headers.set(id, header);
    this.queue.push(id, frame);
  }

  /** A message about prefixes, or `reset`. `false` when it broke the order. */
  event(event: RegionEvent): boolean {
    let effects: Effects;
    try {
      effects = reduce(this.regions, event);
    } catch (error) {
      this.onBroken(error instanceof Error ? error.message : String(error));
      return false;
    }
    this.queue.drop(effects.dropped);
    this.scene.drop(effects.dropped);
    for (const id of effects.dropped) this.headers.delete(id);
    for (const swap of effects.swaps) {
      this.scene.swap(swap.show, swap.remove);
      this.onSwap(swap);
    }
    return true;
  }

  /** A piece is on the GPU. */
  resident(id: ChunkId): void {
    this.headers.delete(id);
    this.event({ type: "resident", id });
  }

  /** Forgets the picture too: another volume, or a GPU that lost it. */
  clear(): void {
    this.event({ type: "reset" });
    this.regions = emptyRegions();
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
