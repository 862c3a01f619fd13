/** Queue in front of the decoding worker: chunks dropped while they wait are never decoded. */

import type { DecodedChunk } from "./decode";
import type { DecodeAnswer, DecodeRequest } from "./worker";

/** The worker, as far as the queue needs it; tests pass their own. */
export interface DecodeWorker {
  postMessage(request: DecodeRequest, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<DecodeAnswer>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
}

/** Chunks handed to the worker at once: it never idles, and little is decoded in vain when an edit makes chunks stale. */
const IN_FLIGHT = 4;

export class DecodeQueue {
  /**
   * Frames that wait, in order of arrival. Bounded by what one generation sends: each region once a prefix; those of a
   * generation that ended are dropped. A browser's WebSocket cannot be told to wait, so no tighter bound can be kept.
   */
  private readonly waiting = new Map<number, ArrayBuffer>();
  private readonly inFlight = new Set<number>();

  constructor(
    private readonly worker: DecodeWorker,
    private readonly onDecoded: (ticket: number, chunk: DecodedChunk) => void,
    private readonly onFailed: (ticket: number, reason: string) => void,
  ) {
    worker.onmessage = ({ data }) => {
      const wanted = this.inFlight.delete(data.ticket);
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
      this.inFlight.delete(ticket);
    }
    this.pump();
  }

  private pump(): void {
    for (const [ticket, frame] of this.waiting) {
      if (this.inFlight.size >= IN_FLIGHT) return;
      this.waiting.delete(ticket);
      this.inFlight.add(ticket);
      this.worker.postMessage({ ticket, frame }, [frame]);
    }
  }
}
