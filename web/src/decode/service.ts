/** The decoding worker: decodes chunks, keeps them as they came while they are in use, and sums up surfaces. */

import { readChunkHeader } from "../protocol/chunk";
import type { Uneven } from "../world/uneven";
import { decodeChunk, type DecodedChunk, type MeshDecoder } from "./decode";
import { MeshSummation, type MeshSums, type WorldAxes } from "./meshSums";

export type DecodeRequest =
  | { readonly type: "decode"; readonly id: number; readonly frame: ArrayBuffer }
  /** These chunks are not in use any more. */
  | { readonly type: "forget"; readonly ids: readonly number[] }
  /** Area and volume of the surface of these chunks; `axes` as in `MeshSummation`. */
  | { readonly type: "sum"; readonly ticket: number; readonly ids: readonly number[]; readonly axes: WorldAxes; readonly uneven?: Uneven };

export type DecodeReply =
  | { readonly type: "decoded"; readonly id: number; readonly chunk: DecodedChunk }
  | { readonly type: "failed"; readonly id: number; readonly error: string }
  | { readonly type: "summed"; readonly ticket: number; readonly sums: MeshSums }
  | { readonly type: "unsummed"; readonly ticket: number; readonly error: string };

/** Longest time for which sums are made before chunks that came meanwhile are decoded. */
const TURN_MS = 20;

const text = (error: unknown) => (error instanceof Error ? error.message : String(error));
const turn = () => new Promise((resolve) => setTimeout(resolve));

export class DecodeService {
  /** Chunks in use, compressed as they came: the page itself keeps no positions. */
  private readonly frames = new Map<number, ArrayBuffer>();

  constructor(
    private readonly decoder: MeshDecoder & { readonly ready: Promise<void> },
    private readonly reply: (reply: DecodeReply, transfer: Transferable[]) => void,
  ) {}

  /** Chunks in use. */
  get size(): number {
    return this.frames.size;
  }

  /** Requests of chunks are answered in their order. */
  receive(request: DecodeRequest): void {
    switch (request.type) {
      case "decode":
        this.frames.set(request.id, request.frame);
        return void this.decode(request.id, request.frame);
      case "forget":
        for (const id of request.ids) this.frames.delete(id);
        return;
      case "sum":
        return void this.sum(request);
    }
  }

  private async decode(id: number, frame: ArrayBuffer): Promise<void> {
    try {
      await this.decoder.ready;
      const chunk = decodeChunk(this.decoder, readChunkHeader(frame), frame);
      const { vertices, indices, values } = chunk;
      this.reply({ type: "decoded", id, chunk }, [vertices.buffer, indices.buffer, ...(values === undefined ? [] : [values.buffer])]);
    } catch (error) {
      this.frames.delete(id);
      this.reply({ type: "failed", id, error: text(error) }, []);
    }
  }

  private async sum({ ticket, ids, axes, uneven }: Extract<DecodeRequest, { readonly type: "sum" }>): Promise<void> {
    try {
      // The frames as of now, even if some are dropped meanwhile.
      const frames = ids.map((id) => this.frameOf(id));
      await this.decoder.ready;
      const summation = new MeshSummation(axes, uneven);
      let began = performance.now();
      for (const frame of frames) {
        const header = readChunkHeader(frame);
        summation.add({ ...decodeChunk(this.decoder, header, frame), region: header.region, lattice: header.lattice });
        if (performance.now() - began < TURN_MS) continue;
        await turn();
        began = performance.now();
      }
      this.reply({ type: "summed", ticket, sums: summation.sums }, []);
    } catch (error) {
      this.reply({ type: "unsummed", ticket, error: text(error) }, []);
    }
  }

  private frameOf(id: number): ArrayBuffer {
    const frame = this.frames.get(id);
    if (frame === undefined) throw new Error(`chunk ${id} is not there any more`);
    return frame;
  }
}
