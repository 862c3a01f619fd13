/** Reader of a mesh chunk's header (PROTOCOL.md, section 4). Pure. */

import { LEVELS, REGION_CELLS } from "./generated";
import type { Vec3 } from "./types";

/** Version of the layout. */
const VERSION = 3;
export const HEADER_BYTES = 96;
export const VERTEX_BYTES = 12;

/** Surfaces that the layout can number. */
const MAX_SURFACES = 4;

/** Maximum size of a region. */
const MAX_SIZE = 2;

/** Two for each grid edge in a region of 32³ cells and on its faces. Larger regions have few triangles. */
const MAX_TRIANGLES = 2 * 3 * REGION_CELLS * (REGION_CELLS + 1) ** 2;
export const MAX_INDICES = 3 * MAX_TRIANGLES;
/** Every vertex belongs to a triangle. */
export const MAX_VERTICES = 3 * MAX_TRIANGLES;

/** Kinds of chunks, by their numbers: a region of a prefix, or the distance of each of its vertices to the isosurface. */
const KINDS = ["cut", "error"] as const;

/** Codings of a mesh, by the lowest bit of its chunk's flags. The second one is sent only on request. */
const CODINGS = ["meshopt", "predictive"] as const;
/** Bit of the flags: values of a field follow the payloads. Sent only on request. */
const HAS_VALUES = 2;
/** What a client may request when it opens a volume. */
export const ASKED_CODINGS: readonly string[] = [...CODINGS.slice(1), "values"];

export interface ChunkHeader {
  readonly kind: (typeof KINDS)[number];
  readonly coding: (typeof CODINGS)[number];
  /** Bytes of the values behind the payloads; 0 if there are none. */
  readonly valueBytes: number;
  readonly generation: number;
  /** Level of the prefix. */
  readonly level: number;
  /** Number of the surface. */
  readonly surface: number;
  /** Lattice units per cell. */
  readonly lattice: number;
  /** Region coordinates: of its low corner, in units of 32 cells, multiples of 2^size. */
  readonly region: Vec3;
  /** The region is a cube of 32·2^size cells. */
  readonly size: number;
  /** In index space; zeros when the region is empty. */
  readonly bounds: { readonly min: Vec3; readonly max: Vec3 };
  readonly vertexCount: number;
  readonly indexCount: number;
  readonly vertexBytes: number;
  readonly indexBytes: number;
  /** Triangles of each level, 0 first. */
  readonly levelTriangles: readonly number[];
}

/** A chunk that violates the protocol; the message has the field, what was found and what was expected. */
export class ChunkError extends Error {
  override readonly name = "ChunkError";
}

function check(ok: boolean, what: string): asserts ok {
  if (!ok) throw new ChunkError(`mesh chunk: ${what}`);
}

/**
 * Reads and checks the header of a whole frame. Nothing is allocated from its counts before they were checked.
 * @throws ChunkError
 */
export function readChunkHeader(frame: ArrayBuffer): ChunkHeader {
  const view = new DataView(frame);
  checkVersion(view);
  const level = view.getUint8(12);
  check(level < LEVELS, `prefix level ${level}, expected 0 to ${LEVELS - 1}`);
  const kind = KINDS[view.getUint8(13)];
  check(kind !== undefined, `kind ${view.getUint8(13)}, expected 0 (cut) or 1 (error)`);
  check(kind === "cut" || level === 0, `kind 1 (error) of level ${level}, expected 0`);
  const surface = view.getUint8(14);
  check(surface < MAX_SURFACES, `surface ${surface}, expected 0 to ${MAX_SURFACES - 1}`);
  const flags = view.getUint8(15);
  const hasValues = (flags & HAS_VALUES) !== 0;
  const coding = CODINGS[flags & ~HAS_VALUES];
  check(coding !== undefined && (kind === "cut" || flags === 0), `flags ${flags} of kind ${kind}, expected 0 (meshopt) or, of cut, 1 (predictive), and 2 more with values`);
  const { region, size } = readRegion(view);
  const lattice = view.getUint16(16, true);
  const maxLattice = Math.floor(0x7fff / (REGION_CELLS << size));
  check(lattice > 0 && lattice <= maxLattice, `${lattice} lattice units per cell, expected 1 to ${maxLattice}`);
  return {
    kind,
    coding,
    generation: view.getUint32(8, true),
    level,
    surface,
    lattice,
    region,
    size,
    bounds: readBounds(view),
    ...readCounts(view, kind, coding, hasValues),
  };
}

function checkVersion(view: DataView): void {
  const bytes = view.byteLength;
  check(bytes >= 8, `${bytes} bytes, expected at least a header of ${HEADER_BYTES} bytes`);
  const magic = String.fromCharCode(...new Uint8Array(view.buffer, 0, 4));
  check(magic === "ISOP", `magic is ${JSON.stringify(magic)}, expected "ISOP"`);
  // The version first: another version may have another layout.
  const version = view.getUint16(4, true);
  check(version === VERSION, `version ${version}, this viewer reads version ${VERSION}: reload the page`);
  check(bytes >= HEADER_BYTES, `${bytes} bytes, expected at least a header of ${HEADER_BYTES} bytes`);
  const headerBytes = view.getUint16(6, true);
  check(headerBytes === HEADER_BYTES, `header length ${headerBytes}, expected ${HEADER_BYTES}`);
}

function readRegion(view: DataView): Pick<ChunkHeader, "region" | "size"> {
  const size = view.getUint16(18, true);
  check(size <= MAX_SIZE, `region size ${size}, expected 0 to ${MAX_SIZE}`);
  const region = vec(20, (at) => view.getUint32(at, true));
  const isAligned = region.every((coordinate) => coordinate % (1 << size) === 0);
  check(isAligned, `region (${region.join(", ")}) of size ${size}, expected multiples of ${1 << size}`);
  return { region, size };
}

function vec(offset: number, read: (offset: number) => number): Vec3 {
  return [read(offset), read(offset + 4), read(offset + 8)];
}

function readBounds(view: DataView): ChunkHeader["bounds"] {
  const min = vec(32, (at) => view.getFloat32(at, true));
  const max = vec(44, (at) => view.getFloat32(at, true));
  check(
    [...min, ...max].every(Number.isFinite) && min.every((low, axis) => low <= (max[axis] ?? low)),
    `bounds (${min.join(", ")}) to (${max.join(", ")}), expected finite numbers, low before high`,
  );
  return { min, max };
}

type Counts = Pick<ChunkHeader, "vertexCount" | "indexCount" | "vertexBytes" | "indexBytes" | "valueBytes" | "levelTriangles">;

function readCounts(view: DataView, kind: ChunkHeader["kind"], coding: ChunkHeader["coding"], hasValues: boolean): Counts {
  const u32 = (offset: number) => view.getUint32(offset, true);
  const vertexCount = u32(56);
  const indexCount = u32(60);
  const vertexBytes = u32(64);
  const indexBytes = u32(68);
  check(vertexCount <= MAX_VERTICES, `${vertexCount} vertices, expected at most ${MAX_VERTICES} in a region`);
  check(indexCount <= MAX_INDICES, `${indexCount} indices, expected at most ${MAX_INDICES} in a region`);
  check(indexCount % 3 === 0, `${indexCount} indices, expected a multiple of 3`);
  check((vertexCount === 0) === (indexCount === 0), `${vertexCount} vertices with ${indexCount} indices`);
  const valueBytes = view.byteLength - HEADER_BYTES - vertexBytes - indexBytes;
  check(
    hasValues && vertexCount > 0 ? valueBytes > 8 : valueBytes === 0,
    `header ${HEADER_BYTES} + vertices ${vertexBytes} + indices ${indexBytes} bytes${hasValues ? " and values" : ""}, the frame has ${view.byteLength}`,
  );
  const hasIndices = vertexCount > 0 && coding === "meshopt";
  const isWhole = vertexBytes > 0 === vertexCount > 0 && indexBytes > 0 === hasIndices;
  const hasNumbers = vertexBytes === 4 * vertexCount && indexBytes === 0;
  check(kind === "cut" ? isWhole : hasNumbers, `${vertexCount} vertices in payloads of ${vertexBytes} and ${indexBytes} bytes`);
  const levelTriangles = Array.from({ length: LEVELS }, (_, level) => u32(72 + 4 * level));
  const triangles = levelTriangles.reduce((sum, n) => sum + n, 0);
  check(triangles === indexCount / 3, `levels add up to ${triangles} triangles, expected ${indexCount / 3}`);
  return { vertexCount, indexCount, vertexBytes, indexBytes, valueBytes, levelTriangles };
}
