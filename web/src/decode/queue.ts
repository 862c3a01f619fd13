/** Queue in front of the decoding worker: chunks dropped while they wait are never decoded. */

import type { DecodedChunk } from "./decode";
import type { Uneven } from "../world/uneven";
import type { MeshSums, WorldAxes } from "./meshSums";
import type { DecodeReply, DecodeRequest } from "./service";

/** The part of the worker's interface that the queue uses; tests pass their own. */
export interface DecodeWorker {
  postMessage(request: DecodeRequest, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<DecodeReply>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
}

/**
 * Maximum number of bytes that the worker has at once, unless one chunk alone has more: enough that the worker is not idle
 * while its replies wait for this thread and that a coarse prefix goes in one piece; little enough (some 2 ms of decoding) that
 * few chunks are decoded in vain when an edit makes them stale.
 */
const MAX_IN_FLIGHT_BYTES = 64 << 10;

export class DecodeQueue {
  /**
   * Waiting frames, in order of arrival. Bounded by the frames of one generation: each region once per prefix; those of a
   * generation that ended are dropped. A browser's WebSocket has no back-pressure, so no tighter bound is possible.
   */
  private readonly waiting = new Map<number, ArrayBuffer>();
  /** Bytes of each chunk that the worker has. */
  private readonly inFlight = new Map<number, number>();
  private inFlightBytes = 0;
  /** Requested sums, by their tickets. */
  private readonly summing = new Map<number, { readonly found: (sums: MeshSums) => void; readonly failed: (error: Error) => void }>();
  private lastTicket = 0;

  constructor(
    private readonly worker: DecodeWorker,
    private readonly onDecoded: (id: number, chunk: DecodedChunk) => void,
    private readonly onFailed: (reason: string) => void,
  ) {
    worker.onmessage = ({ data }) => this.received(data);
    worker.onerror = (event) => {
      event.preventDefault();
      const reason = `the decoding worker failed: ${event.message}`;
      for (const { failed } of this.summing.values()) failed(new Error(reason));
      this.summing.clear();
      onFailed(reason);
    };
  }

  /** Chunks that are not decoded yet. */
  get size(): number {
    return this.waiting.size + this.inFlight.size;
  }

  /** Takes ownership of the frame: its buffer moves to the worker. */
  push(id: number, frame: ArrayBuffer): void {
    this.waiting.set(id, frame);
    this.pump();
  }

  /** Drops chunks: waiting ones are never decoded, replies for those in flight are ignored, and decoded ones are released. */
  drop(ids: Iterable<number>): void {
    const sent = [...ids].filter((id) => !this.waiting.delete(id));
    if (sent.length > 0) this.worker.postMessage({ type: "forget", ids: sent }, []);
    for (const id of sent) this.release(id);
    this.pump();
  }

  /**
   * Area and volume of the surface of these chunks, which were decoded and not dropped.
   * @param axes world vectors of a step along each axis of the index space
   * @throws if one of them was dropped meanwhile
   */
  sum(ids: readonly number[], axes: WorldAxes, uneven?: Uneven): Promise<MeshSums> {
    const ticket = ++this.lastTicket;
    return new Promise((found, failed) => {
      this.summing.set(ticket, { found, failed });
      this.worker.postMessage({ type: "sum", ticket, ids, axes, ...(uneven === undefined ? {} : { uneven }) }, []);
    });
  }

  private received(reply: DecodeReply): void {
    if (reply.type === "summed" || reply.type === "unsummed") {
      const asked = this.summing.get(reply.ticket);
      this.summing.delete(reply.ticket);
      if (reply.type === "summed") asked?.found(reply.sums);
      else asked?.failed(new Error(reply.error));
      return;
    }
    const wanted = this.release(reply.id);
    this.pump();
    if (!wanted) return;
    if (reply.type === "decoded") this.onDecoded(reply.id, reply.chunk);
    else this.onFailed(reply.error);
  }

  /** Whether the chunk was still in flight. */
  private release(id: number): boolean {
    this.inFlightBytes -= this.inFlight.get(id) ?? 0;
    return this.inFlight.delete(id);
  }

  private pump(): void {
    for (const [id, frame] of this.waiting) {
      if (this.inFlightBytes > 0 && this.inFlightBytes + frame.byteLength > MAX_IN_FLIGHT_BYTES) return;
      this.waiting.delete(id);
      this.inFlight.set(id, frame.byteLength);
      this.inFlightBytes += frame.byteLength;
      this.worker.postMessage({ type: "decode", id, frame }, [frame]);
    }
  }
}
