/** Planes of samples, with their place in the world. Normative: `GET /api/v1/volumes/{id}/slices` in `/api/v1/openapi.json`. */

import type { Vec3 } from "../protocol/types";
import { ask } from "./rest";

export interface PlaneRequest {
  readonly volume: string;
  readonly step: number;
  readonly field: string;
  readonly axis: "x" | "y" | "z";
  readonly index: number;
}

export interface Plane {
  /** Row after row; a missing sample is NaN. */
  readonly samples: Float32Array<ArrayBuffer>;
  readonly size: readonly [number, number];
  /** World position of the first sample, and world vectors to the next one in its row and to the next row. */
  readonly origin: Vec3;
  readonly right: Vec3;
  readonly down: Vec3;
  /** The axes of the volume along the rows, and from row to row; older servers do not send them. */
  readonly axes?: readonly ["x" | "y" | "z", "x" | "y" | "z"];
}

/** The header `isopeel-slice`. */
interface SliceInfo {
  readonly type: string;
  readonly dims: readonly [number, number];
  /** Samples of this value are missing, and those that are no finite number. */
  readonly missing: number | null;
  readonly axes?: Plane["axes"];
  readonly origin: Vec3;
  readonly steps: readonly [Vec3, Vec3];
}

/** Little-endian samples of each type that volumes have. */
const READERS: Readonly<Record<string, { readonly bytes: number; readonly read: (data: DataView, at: number) => number }>> = {
  u8: { bytes: 1, read: (data, at) => data.getUint8(at) },
  i8: { bytes: 1, read: (data, at) => data.getInt8(at) },
  u16: { bytes: 2, read: (data, at) => data.getUint16(at, true) },
  i16: { bytes: 2, read: (data, at) => data.getInt16(at, true) },
  f32: { bytes: 4, read: (data, at) => data.getFloat32(at, true) },
};

/** @throws when the server refuses, or answers with something that is no plane of samples */
export async function fetchSlice(base: URL, { volume, ...query }: PlaneRequest, signal?: AbortSignal): Promise<Plane> {
  const url = new URL(`api/v1/volumes/${encodeURIComponent(volume)}/slices`, base);
  for (const [name, value] of Object.entries(query)) url.searchParams.set(name, String(value));
  const response = await ask(url, signal === undefined ? {} : { signal });
  return readPlane(response.headers.get("isopeel-slice"), await response.arrayBuffer());
}

/** @throws when header and samples do not fit */
export function readPlane(header: string | null, body: ArrayBuffer): Plane {
  if (header === null) throw new Error("this server's slices do not say what they are");
  const { type, dims, axes, origin, steps, missing } = JSON.parse(header) as SliceInfo;
  const reader = READERS[type];
  if (reader === undefined) throw new Error(`a slice with samples of type ${type}, expected one of ${Object.keys(READERS).join(", ")}`);
  const count = dims[0] * dims[1];
  if (body.byteLength !== count * reader.bytes) {
    throw new Error(`a slice of ${body.byteLength} bytes, expected ${dims[0]} × ${dims[1]} samples of ${reader.bytes}`);
  }
  const data = new DataView(body);
  // Rounded to the 32-bit float that the header's decimal means: -1e34 itself is none.
  const hole = type === "f32" && missing !== null ? Math.fround(missing) : missing;
  const samples = Float32Array.from({ length: count }, (_, i) => {
    const value = reader.read(data, i * reader.bytes);
    return value === hole || !Number.isFinite(value) ? NaN : value;
  });
  return { samples, size: dims, origin, right: steps[0], down: steps[1], ...(axes === undefined ? {} : { axes }) };
}
