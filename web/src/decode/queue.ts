/** Queue in front of the decoding worker: chunks dropped while they wait are never decoded. */

import type { DecodedChunk } from "./decode";
import type { DecodeReply, DecodeRequest } from "./worker";

/** The worker, as far as the queue needs it; tests pass their own. */
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
   * Frames that wait, in order of arrival. Bounded by what one generation sends: each region once a prefix; those of a
   * generation that ended are dropped. A browser's WebSocket cannot be told to wait, so no tighter bound can be kept.
   */
  private readonly waiting = new Map<number, ArrayBuffer>();
  /** Bytes of each chunk that the worker has. */
  private readonly inFlight = new Map<number, number>();
  private inFlightBytes = 0;

  constructor(
    private readonly worker: DecodeWorker,
    onDecoded: (id: number, chunk: DecodedChunk) => void,
    onFailed: (reason: string) => void,
  ) {
    worker.onmessage = ({ data }) => {
      const wanted = this.release(data.id);
      this.pump();
      if (!wanted) return;
      if ("chunk" in data) onDecoded(data.id, data.chunk);
      else onFailed(data.error);
    };
    worker.onerror = (event) => {
      event.preventDefault();
      onFailed(`the decoding worker failed: ${event.message}`);
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

  /** Forgets chunks: those that wait are never decoded, replies for those in flight are ignored. */
  drop(ids: Iterable<number>): void {
    for (const id of ids) {
      this.waiting.delete(id);
      this.release(id);
    }
    this.pump();
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
      this.worker.postMessage({ id, frame }, [frame]);
    }
  }
}
