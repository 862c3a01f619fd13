/** Queue in front of the decoding worker: chunks dropped while they wait are never decoded. */

import type { DecodedChunk } from "./decode";
import type { DecodeAnswer, DecodeRequest } from "./worker";

/** The worker, as far as the queue needs it; tests pass their own. */
export interface DecodeWorker {
  postMessage(request: DecodeRequest, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<DecodeAnswer>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
}

/**
 * Bytes handed to the worker at once, or one chunk where it has more: the worker never idles while answers wait for this
 * thread, a coarse prefix goes in one piece, and little is decoded in vain when an edit makes chunks stale (some 2 ms).
 */
const IN_FLIGHT_BYTES = 64 << 10;

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
    private readonly onDecoded: (ticket: number, chunk: DecodedChunk) => void,
    private readonly onFailed: (ticket: number, reason: string) => void,
  ) {
    worker.onmessage = ({ data }) => {
      const wanted = this.release(data.ticket);
      this.pump();
      if (!wanted) return;
      if ("chunk" in data) this.onDecoded(data.ticket, data.chunk);
      else this.onFailed(data.ticket, data.error);
    };
    worker.onerror = (event) => {
      event.preventDefault();
      this.onFailed(-1, `the decoding worker failed: ${event.message}`);
    };
  }

  /** Chunks that are not decoded yet. */
  get size(): number {
    return this.waiting.size + this.inFlight.size;
  }

  /** Takes the frame over: its buffer moves to the worker. */
  push(ticket: number, frame: ArrayBuffer): void {
    this.waiting.set(ticket, frame);
    this.pump();
  }

  /** Forgets chunks: those that wait are never decoded, the answers of those under way are thrown away. */
  drop(tickets: Iterable<number>): void {
    for (const ticket of tickets) {
      this.waiting.delete(ticket);
      this.release(ticket);
    }
    this.pump();
  }

  /** Whether the chunk was still under way. */
  private release(ticket: number): boolean {
    this.inFlightBytes -= this.inFlight.get(ticket) ?? 0;
    return this.inFlight.delete(ticket);
  }

  private pump(): void {
    for (const [ticket, frame] of this.waiting) {
      if (this.inFlightBytes > 0 && this.inFlightBytes + frame.byteLength > IN_FLIGHT_BYTES) return;
      this.waiting.delete(ticket);
      this.inFlight.set(ticket, frame.byteLength);
      this.inFlightBytes += frame.byteLength;
      this.worker.postMessage({ ticket, frame }, [frame]);
    }
  }
}
