/** A volume at a low resolution. Normative: `GET /api/v1/volumes/{id}/overview` in `/api/v1/openapi.json`. */

import type { Vec3 } from "../protocol/types";
import { ask } from "./rest";

export interface OverviewRequest {
  readonly volume: string;
  readonly step: number;
  readonly field: string;
  readonly mode: "mean" | "maximum";
}

/** The header `isopeel-overview`. */
interface OverviewInfo {
  /** Values along each axis. */
  readonly dims: Vec3;
  /** Samples of a block for which a value stands, along each axis. */
  readonly factors: Vec3;
  /** What the codes 1 and 255 stand for. */
  readonly range: readonly [number, number];
}

export interface Overview extends OverviewInfo {
  /** x fastest; 0 is missing. */
  readonly codes: Uint8Array<ArrayBuffer>;
}

/** @throws when the server refuses, or answers with something that is no overview */
export async function fetchOverview(base: URL, { volume, ...query }: OverviewRequest, signal?: AbortSignal): Promise<Overview> {
  const url = new URL(`api/v1/volumes/${encodeURIComponent(volume)}/overview`, base);
  for (const [name, value] of Object.entries(query)) url.searchParams.set(name, String(value));
  const response = await ask(url, signal === undefined ? {} : { signal });
  return readOverview(response.headers.get("isopeel-overview"), await response.arrayBuffer());
}

/** @throws when header and values do not fit */
export function readOverview(header: string | null, body: ArrayBuffer): Overview {
  if (header === null) throw new Error("this server's overviews do not say what they are");
  const { dims, factors, range } = JSON.parse(header) as OverviewInfo;
  const count = dims[0] * dims[1] * dims[2];
  if (body.byteLength !== count) throw new Error(`an overview of ${body.byteLength} bytes, expected ${dims.join(" × ")}`);
  return { dims, factors, range, codes: new Uint8Array(body) };
}
