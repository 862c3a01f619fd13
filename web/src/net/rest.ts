/** REST calls the viewer makes. Errors carry the server's message (`application/problem+json`). */

import type { VolumeSummary } from "../protocol/types";

interface Problem {
  readonly title?: string;
  readonly detail?: string;
}

/** Volumes the server has. */
export async function listVolumes(base: URL): Promise<readonly VolumeSummary[]> {
  const url = new URL("api/v1/volumes", base);
  const response = await fetch(url, { headers: { accept: "application/json" } });
  if (!response.ok) {
    const problem = await response.json().then(
      (body) => body as Problem,
      (): Problem => ({}),
    );
    throw new Error(problem.detail ?? problem.title ?? `${url.pathname}: HTTP ${response.status}`);
  }
  return (await response.json()) as readonly VolumeSummary[];
}
