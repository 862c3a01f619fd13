/**
 * From binary frames to the picture: header check, region map, decoding, upload, swap. The one place where protocol,
 * decoder, region map and scene meet.
 */

import { emptyRegions, isSettled, reduce, type Effects, type RegionEvent, type Swap, type Ticket } from "./chunks/regions";
import type { DecodedChunk } from "./decode/decode";
import { DecodeQueue, type DecodeWorker } from "./decode/queue";
import { readChunkHeader, type ChunkHeader } from "./protocol/chunk";
import { REGION_CELLS } from "./protocol/types";
import type { PatchData } from "./scene/patch";

/** What the pipeline needs of the scene. */
export interface Stage {
  upload(id: number, data: PatchData): void;
  swap(show: readonly number[], remove: readonly number[]): void;
  drop(ids: readonly number[]): void;
  clear(): void;
}

export class SurfaceStream {
  private regions = emptyRegions();
  private readonly headers = new Map<Ticket, ChunkHeader>();
  private readonly queue: DecodeQueue;
  private ticket = 0;

  /**
   * `onSwap` hears of each prefix when it is shown; `onBroken` when the server or a chunk broke the protocol: the session
   * then has to start over, with `reset`.
   */
  constructor(
    worker: DecodeWorker,
    private readonly stage: Stage,
    private readonly onSwap: (swap: Swap) => void,
    private readonly onBroken: (reason: string) => void,
  ) {
    this.queue = new DecodeQueue(
      worker,
      (ticket, chunk) => this.decoded(ticket, chunk),
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
    const ticket = vertexCount === 0 ? null : ++this.ticket;
    if (!this.event({ type: "chunk", generation, level, region: region.join(), ticket }) || ticket === null) return;
    this.headers.set(ticket, header);
    this.queue.push(ticket, frame);
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
    this.stage.drop(effects.dropped);
    for (const ticket of effects.dropped) this.headers.delete(ticket);
    for (const swap of effects.swaps) {
      this.stage.swap(swap.show, swap.remove);
      this.onSwap(swap);
    }
    return true;
  }

  /** A piece is on the GPU. */
  resident(ticket: Ticket): void {
    this.headers.delete(ticket);
    this.event({ type: "resident", ticket });
  }

  /** Forgets the picture too: another volume, or a GPU that lost it. */
  clear(): void {
    this.event({ type: "reset" });
    this.regions = emptyRegions();
    this.headers.clear();
    this.stage.clear();
  }

  private decoded(ticket: Ticket, chunk: DecodedChunk): void {
    const header = this.headers.get(ticket);
    if (header === undefined) return;
    const [a, b, c] = header.region;
    this.stage.upload(ticket, {
      vertices: chunk.vertices,
      indices: chunk.indices,
      levelTriangles: header.levelTriangles,
      corner: [a * REGION_CELLS, b * REGION_CELLS, c * REGION_CELLS],
      lattice: header.lattice,
      bounds: header.bounds,
    });
  }
}
