/** Uploads of files to volumes of the server: declared, sent in parts that resume after a lost connection (tus 1.0), and read. */

import { Upload as Tus, type DetailedError } from "tus-js-client";
import type { UploadInfo, UploadList } from "../protocol/types";
import { request } from "./credentials";
import { ask, checked } from "./rest";

/** A file, and its name with the folders that it is in. */
export interface NamedFile {
  readonly name: string;
  readonly file: File;
}

export type UploadPhase =
  | "declaring"
  | "sending"
  /** The connection was lost; the request is retried. */
  | "waiting"
  /** All bytes are uploaded; the server reads the files as a volume. */
  | "reading";

/** Size of a part. Proxies buffer a part in memory or on disk; a lost connection loses less than one part. */
const PART_BYTES = 8 << 20;
/** Pauses between retries: a server that restarts is back within minutes. */
const RETRY_MS = [500, 1000, 2000, 4000, ...Array<number>(120).fill(5000)];

/** The user's uploads. */
export async function listUploads(base: URL): Promise<UploadList> {
  return (await (await ask(new URL("api/v1/uploads", base), {})).json()) as UploadList;
}

/** Removes an upload and its volumes. */
export async function removeUpload(base: URL, id: string): Promise<void> {
  await ask(address(base, id), { method: "DELETE" });
}

/**
 * Sends files and returns their upload. If the same files are sent again, continues an earlier page's unfinished upload of them.
 *
 * @throws with the server's own message if it refuses; an `AbortError` when `signal` ends it, and the upload is removed
 */
export async function upload(base: URL, files: readonly NamedFile[], signal: AbortSignal, onProgress: (phase: UploadPhase, sent: number) => void): Promise<UploadInfo> {
  onProgress("declaring", 0);
  // Not cancelled by the signal, because the declared upload must then be removed.
  const made = await declare(base, files);
  try {
    signal.throwIfAborted();
    if (made.state !== "ready") await send(address(base, made.id), files, signal, onProgress);
    signal.throwIfAborted();
    onProgress("reading", made.bytes);
    return await finish(new URL(`api/v1/uploads/${made.id}/finish`, base), signal);
  } catch (error) {
    // An upload that existed before must not be removed by this page.
    if (signal.aborted && made.state !== "ready") await removeUpload(base, made.id).catch(() => undefined);
    throw error;
  }
}

async function declare(base: URL, files: readonly NamedFile[]): Promise<UploadInfo> {
  const body = JSON.stringify({ files: files.map(({ name, file }) => ({ name, bytes: file.size })) });
  const headers = { "content-type": "application/json", "idempotency-key": keyOf(files) };
  const response = await ask(new URL("api/v1/uploads", base), { method: "POST", headers, body });
  return (await response.json()) as UploadInfo;
}

/** Requests the reading of the files. The request is idempotent, so it is retried until the server is back, or has done earlier requests. */
async function finish(url: URL, signal: AbortSignal): Promise<UploadInfo> {
  for (const delay of RETRY_MS) {
    const response = await request(url, { method: "POST", signal }).catch(() => undefined);
    signal.throwIfAborted();
    const status = response?.status ?? 0;
    if (response !== undefined && (status === 409 || !isPassing(status))) return (await (await checked(url, response)).json()) as UploadInfo;
    await new Promise((done) => setTimeout(done, delay));
  }
  throw new Error(LOST);
}

function send(url: URL, files: readonly NamedFile[], signal: AbortSignal, onProgress: (phase: UploadPhase, sent: number) => void): Promise<void> {
  return new Promise((done, failed) => {
    // One after the other; the browser reads each file only when it is sent.
    const tus = new Tus(new Blob(files.map(({ file }) => file)), {
      uploadUrl: url.href,
      chunkSize: PART_BYTES,
      retryDelays: RETRY_MS,
      storeFingerprintForResuming: false,
      onProgress: (sent) => onProgress("sending", sent),
      onShouldRetry: (error) => {
        const retries = isPassing(error.originalResponse?.getStatus() ?? 0);
        if (retries) onProgress("waiting", 0);
        return retries;
      },
      onError: (error) => failed(new Error(wordsOf(error))),
      onSuccess: () => done(),
    });
    signal.addEventListener("abort", () => {
      void tus.abort();
      failed(signal.reason as Error);
    });
    if (signal.aborted) failed(signal.reason as Error);
    else tus.start();
  });
}

/** Whether a retry may succeed: no connection, a conflicting request, a server or proxy that is busy or starting. */
export function isPassing(status: number): boolean {
  return [0, 409, 423, 429, 500, 502, 503, 504].includes(status);
}

const LOST = "the connection to the server was lost for too long; drop the same files again to go on";

/** The server's own message, if it has sent one. */
function wordsOf(error: Error): string {
  const response = (error as Partial<DetailedError>).originalResponse;
  try {
    const { detail } = JSON.parse(response?.getBody() ?? "") as { readonly detail?: string };
    if (detail !== undefined) return detail;
  } catch {
    // No answer, one without a body, or none of this server's.
  }
  if (response === null || response === undefined) return LOST;
  const status = response.getStatus();
  return status === 404 ? "the server has removed the upload meanwhile; drop the files again" : `the server answered with HTTP ${status}`;
}

function address(base: URL, id: string): URL {
  return new URL(`api/v1/uploads/${id}`, base);
}

/** The same for the same files, whatever page sends them: names, sizes and times. Two 32-bit FNV-1a hashes. */
export function keyOf(files: readonly NamedFile[]): string {
  const text = JSON.stringify(files.map(({ name, file }) => [name, file.size, file.lastModified]));
  const hash = (seed: number) => {
    let value = seed;
    for (let i = 0; i < text.length; i += 1) value = Math.imul(value ^ text.charCodeAt(i), 0x01000193);
    return (value >>> 0).toString(16).padStart(8, "0");
  };
  return `files-${hash(0x811c9dc5)}${hash(0x2f7a1b3d)}-${text.length}`;
}
