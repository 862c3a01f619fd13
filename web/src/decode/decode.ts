/** Decodes one mesh chunk into arrays ready for WebGL. Pure; runs in the worker and in tests. */

import { HEADER_BYTES, VERTEX_BYTES, ChunkError, type ChunkHeader } from "../protocol/chunk";
import { decodePredictive } from "./predictive";

/** The functions of meshoptimizer's decoder that are used. */
export interface MeshDecoder {
  decodeVertexBuffer(target: Uint8Array, count: number, size: number, source: Uint8Array): void;
  decodeIndexBuffer(target: Uint8Array, count: number, size: number, source: Uint8Array): void;
}

export interface DecodedChunk {
  /**
   * Interleaved, six 16-bit words a vertex: position x, y, z in lattice units, signed; both octahedral normal bytes (x low,
   * y high); s; f̂. The layout of the wire is that on the GPU.
   */
  readonly vertices: Int16Array<ArrayBuffer>;
  /** Three per triangle; 16-bit when the vertices allow. */
  readonly indices: Uint16Array<ArrayBuffer> | Uint32Array<ArrayBuffer>;
  /** The value of a field at each vertex, NaN if it is missing; only if the chunk has values. */
  readonly values?: Float32Array<ArrayBuffer>;
}

/** Step of a vertex without a value, and that of the end of the range. */
const MISSING = 65535;
const LAST_STEP = MISSING - 1;

/**
 * Decodes a frame whose header was read and checked.
 * @throws ChunkError when a payload is damaged or an index has no vertex
 */
export function decodeChunk(decoder: MeshDecoder, header: ChunkHeader, frame: ArrayBuffer): DecodedChunk {
  const mesh = decodeMesh(decoder, header, frame);
  return header.valueBytes === 0 ? mesh : { ...mesh, values: decodeValues(decoder, header, frame) };
}

/** The values behind the payloads: the ends of their range, then steps between these. */
function decodeValues(decoder: MeshDecoder, { vertexCount, vertexBytes, indexBytes, valueBytes, region }: ChunkHeader, frame: ArrayBuffer): Float32Array<ArrayBuffer> {
  const from = HEADER_BYTES + vertexBytes + indexBytes;
  const range = new DataView(frame, from, 8);
  const [low, high] = [range.getFloat32(0, true), range.getFloat32(4, true)];
  const words = new Uint16Array(2 * vertexCount);
  const where = `mesh chunk of region (${region.join(", ")})`;
  if (!Number.isFinite(low) || !Number.isFinite(high) || low > high) throw new ChunkError(`${where}: values from ${low} to ${high}, expected finite numbers in ascending order`);
  try {
    decoder.decodeVertexBuffer(new Uint8Array(words.buffer), vertexCount, 4, new Uint8Array(frame, from + 8, valueBytes - 8));
  } catch (error) {
    throw new ChunkError(`${where}: damaged values: ${error instanceof Error ? error.message : String(error)}`);
  }
  return Float32Array.from({ length: vertexCount }, (_, i) => {
    const step = words[2 * i] ?? MISSING;
    return step === MISSING ? NaN : low + (step / LAST_STEP) * (high - low);
  });
}

function decodeMesh(decoder: MeshDecoder, header: ChunkHeader, frame: ArrayBuffer): DecodedChunk {
  const { vertexCount, indexCount, vertexBytes, indexBytes } = header;
  if (header.coding === "predictive" && vertexCount > 0) {
    const decoded = decodePredictive(header, new Uint8Array(frame, HEADER_BYTES, vertexBytes));
    return { vertices: decoded.vertices, indices: narrow(decoded.indices, vertexCount) };
  }
  const vertices = new Int16Array((vertexCount * VERTEX_BYTES) / 2);
  const indices = new Uint32Array(indexCount);
  try {
    decoder.decodeVertexBuffer(
      new Uint8Array(vertices.buffer),
      vertexCount,
      VERTEX_BYTES,
      new Uint8Array(frame, HEADER_BYTES, vertexBytes),
    );
    decoder.decodeIndexBuffer(
      new Uint8Array(indices.buffer),
      indexCount,
      4,
      new Uint8Array(frame, HEADER_BYTES + vertexBytes, indexBytes),
    );
  } catch (error) {
    throw new ChunkError(
      `mesh chunk of region (${header.region.join(", ")}): damaged payload: ${error instanceof Error ? error.message : String(error)}`,
    );
  }
  let largest = 0;
  for (const index of indices) if (index > largest) largest = index;
  if (largest >= vertexCount) {
    throw new ChunkError(
      `mesh chunk of region (${header.region.join(", ")}): index ${largest}, expected below ${vertexCount} vertices`,
    );
  }
  return { vertices, indices: narrow(indices, vertexCount) };
}

/** Indices of 16 bits if there are few enough vertices, else of 32 bits. */
const narrow = (indices: Uint32Array<ArrayBuffer>, vertexCount: number): DecodedChunk["indices"] =>
  vertexCount <= 0x10000 ? Uint16Array.from(indices) : indices;
