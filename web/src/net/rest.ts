/** REST calls the viewer makes. Errors carry the server's message (`application/problem+json`). */

import type { Problem, VolumeSummary } from "../protocol/types";

/** Volumes the server has. */
export async function listVolumes(base: URL): Promise<readonly VolumeSummary[]> {
  const url = new URL("api/v1/volumes", base);
  const response = await fetch(url, { headers: { accept: "application/json" } });
  if (!response.ok) {
    const problem = await response.json().then(
      (body) => body as Partial<Problem>,
      (): Partial<Problem> => ({}),
    );
    throw new Error(problem.detail ?? problem.title ?? `${url.pathname}: HTTP ${response.status}`);
  }
  return (await response.json()) as readonly VolumeSummary[];
}
