/** REST calls the viewer makes. Errors carry the server's message (`application/problem+json`). */

import { request as send } from "./credentials";
import type { Edit, Problem, VolumeSummary } from "../protocol/types";

/** Volumes the server has. */
export async function listVolumes(base: URL): Promise<readonly VolumeSummary[]> {
  const response = await ask(new URL("api/v1/volumes", base), { headers: { accept: "application/json" } });
  return (await response.json()) as readonly VolumeSummary[];
}

/** The mesh of a view as a file. */
export async function extract(base: URL, volume: string, step: number, format: string, edit: Edit): Promise<Blob> {
  const response = await ask(new URL("api/v1/extract", base), {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify({ ...edit, volume, step, format }),
  });
  return response.blob();
}

/** @throws with the server's own words where it refuses */
export async function ask(url: URL, request: RequestInit): Promise<Response> {
  return checked(url, await send(url, request));
}

/** @throws as `ask` */
export async function checked(url: URL, response: Response): Promise<Response> {
  if (response.ok) return response;
  const problem = await response.json().then(
    (body) => body as Partial<Problem>,
    (): Partial<Problem> => ({}),
  );
  throw new Error(problem.detail ?? problem.title ?? `${url.pathname}: HTTP ${response.status}`);
}
