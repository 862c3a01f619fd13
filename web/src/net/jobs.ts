/** Batch jobs: surfaces that the server makes one after the other, and keeps. Loaded with their card. */

import { Zip, ZipPassThrough } from "fflate";
import type { Edit, JobInfo } from "../protocol/types";
import { request } from "./credentials";
import { ask, checked } from "./rest";

/** A requested file, as in `POST jobs`. */
export type Extraction = Edit & { readonly step: number; readonly format: string };

export interface JobRequest {
  readonly volume: string;
  readonly extractions: readonly Extraction[];
}

/** A page holds a whole file in memory before it saves it. */
const MAX_FETCHED_BYTES = 2 ** 30;

/** The user's jobs, the latest first. */
export async function listJobs(base: URL): Promise<readonly JobInfo[]> {
  return (await (await ask(address(base), {})).json()) as readonly JobInfo[];
}

/** @param key the same request with the same key makes one job, even if the first answer was lost */
export async function submitJob(base: URL, wanted: JobRequest, key: string): Promise<JobInfo> {
  const headers = { "content-type": "application/json", "idempotency-key": key };
  return (await (await ask(address(base), { method: "POST", headers, body: JSON.stringify(wanted) })).json()) as JobInfo;
}

/** Cancels a job; its results so far are kept. */
export async function cancelJob(base: URL, id: string): Promise<void> {
  await ask(address(base, `/${id}/cancel`), { method: "POST" });
}

/** Removes a finished job and its results. */
export async function removeJob(base: URL, id: string): Promise<void> {
  await ask(address(base, `/${id}`), { method: "DELETE" });
}

/**
 * Fetches the results of a job: the file itself if there is one, else a zip of them. Files are named by the volume, their numbers and
 * isovalues.
 *
 * @param volume its name in files
 * @throws if there is none, or if they exceed `MAX_FETCHED_BYTES`
 */
export async function fetchResults(base: URL, { id, extractions, bytes }: JobInfo, volume: string): Promise<{ readonly name: string; readonly file: Blob }> {
  if (bytes > MAX_FETCHED_BYTES) throw new Error(`the results have ${bytes} bytes, more than a page can hold: isopeel jobs fetch ${id}`);
  const files: { readonly name: string; readonly file: Blob }[] = [];
  for (let n = 0; n < extractions.total && files.length < extractions.done; n += 1) {
    const url = address(base, `/${id}/results/${n}`);
    const response = await request(url);
    // One that failed has no result; the others have.
    if (response.status === 404) continue;
    const { headers } = await checked(url, response);
    const [, own] = /filename="([\w.+-]+)"/.exec(headers.get("content-disposition") ?? "") ?? [];
    files.push({ name: `${volume}-${own ?? `${String(n).padStart(5, "0")}.bin`}`, file: await response.blob() });
  }
  const [first] = files;
  if (first === undefined) throw new Error("the job has no results");
  return files.length === 1 ? first : { name: `${volume}-${id.slice(0, 8)}.zip`, file: await zipped(files) };
}

async function zipped(files: readonly { readonly name: string; readonly file: Blob }[]): Promise<Blob> {
  const pieces: Uint8Array<ArrayBuffer>[] = [];
  let failed: Error | undefined;
  // Meshes are hardly smaller when they are compressed once more, and that takes long.
  const zip = new Zip((error, piece) => {
    if (error === null) pieces.push(piece.slice());
    else failed = error;
  });
  for (const { name, file } of files) {
    const entry = new ZipPassThrough(name);
    zip.add(entry);
    entry.push(new Uint8Array(await file.arrayBuffer()), true);
  }
  zip.end();
  if (failed !== undefined) throw failed;
  return new Blob(pieces, { type: "application/zip" });
}

function address(base: URL, path = ""): URL {
  return new URL(`api/v1/jobs${path}`, base);
}
