/** REST calls the viewer makes. Errors carry the server's message (`application/problem+json`). */

import { request as send } from "./credentials";
import type { Edit, Problem, UnreadablePath, VolumeSummary } from "../protocol/types";

/** How long the server may take for the list of volumes, which is in its memory; a slow line, too. */
const LIST_LIMIT_MS = 15_000;

/**
 * Volumes the server has.
 *
 * @throws also if the answer is not complete in time
 */
export async function listVolumes(base: URL, limitMs = LIST_LIMIT_MS): Promise<readonly VolumeSummary[]> {
  const signal = AbortSignal.timeout(limitMs);
  try {
    const response = await ask(new URL("api/v1/volumes", base), { headers: { accept: "application/json" }, signal });
    return (await response.json()) as readonly VolumeSummary[];
  } catch (error) {
    if (signal.aborted) throw new Error(`the server has not answered within ${limitMs / 1000} s`);
    throw error;
  }
}

/** Paths that the server was given and cannot read. */
export async function listUnreadable(base: URL, limitMs = LIST_LIMIT_MS): Promise<readonly UnreadablePath[]> {
  const request = { headers: { accept: "application/json" }, signal: AbortSignal.timeout(limitMs) };
  const response = await ask(new URL("api/v1/unreadable", base), request);
  return (await response.json()) as readonly UnreadablePath[];
}

/** The mesh of a view as a file. */
export async function extract(base: URL, volume: string, step: number, format: string, edit: Edit): Promise<Blob> {
  const url = new URL("api/v1/extract", base);
  // For a proxy of several servers, which does not read the body.
  url.searchParams.set("volume", volume);
  const response = await ask(url, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify({ ...withFieldValues(edit), volume, step, format }),
  });
  return response.blob();
}

/** A file has the values of the field for colours at its vertices, if the format can hold them. */
function withFieldValues({ colorField, ...edit }: Edit): object {
  return colorField === undefined || colorField === null ? edit : { ...edit, fieldValues: [colorField] };
}

/** @throws with the server's own message if it refuses */
export async function ask(url: URL, request: RequestInit): Promise<Response> {
  return checked(url, await send(url, request));
}

/** @throws as `ask`; a mistake in what is typed has a status of its own, and is a problem all the same */
export async function checked(url: URL, response: Response): Promise<Response> {
  if (response.ok && response.headers.get("content-type") !== "application/problem+json") return response;
  const problem = await response.json().then(
    (body) => body as Partial<Problem>,
    (): Partial<Problem> => ({}),
  );
  throw new Error(problem.detail ?? problem.title ?? `${url.pathname}: HTTP ${response.status}`);
}
