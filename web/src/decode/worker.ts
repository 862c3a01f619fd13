/** The decoding worker: one chunk in, one reply out, in order. `queue.ts` decides which chunks are decoded. */

import { MeshoptDecoder } from "meshoptimizer/decoder";
import { readChunkHeader } from "../protocol/chunk";
import { decodeChunk, type DecodedChunk } from "./decode";
import { smoothFeatures } from "./smoothing";

export interface DecodeRequest {
  readonly id: number;
  readonly frame: ArrayBuffer;
}

export type DecodeReply =
  | { readonly id: number; readonly chunk: DecodedChunk }
  | { readonly id: number; readonly error: string };

/** What the worker uses of its global scope; the DOM's types describe windows only. */
interface WorkerScope {
  postMessage(reply: DecodeReply, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<DecodeRequest>) => void) | null;
}

const scope = self as unknown as WorkerScope;

async function reply({ id, frame }: DecodeRequest): Promise<void> {
  try {
    await MeshoptDecoder.ready;
    const chunk = decodeChunk(MeshoptDecoder, readChunkHeader(frame), frame);
    smoothFeatures(chunk.vertices, chunk.indices);
    scope.postMessage({ id, chunk }, [chunk.vertices.buffer, chunk.indices.buffer]);
  } catch (error) {
    scope.postMessage({ id, error: error instanceof Error ? error.message : String(error) }, []);
  }
}

scope.onmessage = (event) => void reply(event.data);
