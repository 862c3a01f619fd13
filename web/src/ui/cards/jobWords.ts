/** Batch jobs in words. Pure. */

import type { JobInfo } from "../../protocol/types";
import { formatBytes, formatCount } from "../format";

type Titles = readonly { readonly id: string; readonly title: string }[] | undefined;

/** The title of a volume; its id if the server no longer has it. */
export const titleOf = (volumes: Titles, id: string) => volumes?.find((volume) => volume.id === id)?.title ?? id;

const files = (count: number) => (count === 1 ? "1 file" : `${formatCount(count)} files`);
/** Extractions whose surfaces have no triangles. */
const withoutSurface = (count: number) => (count > 0 ? `, ${formatCount(count)} without a surface` : "");

/** 12 s, 5 min, 3 h: about as long. */
export function formatDuration(seconds: number): string {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

const PAUSES: Readonly<Record<string, string>> = {
  "disk-full": "the server’s disk is full",
  storage: "the server’s disk takes no results",
};

/** The state of a job, in words. */
export function jobText({ state, paused, extractions, bytes, etaSeconds, error }: JobInfo): string {
  const { total, done, failed, empty } = extractions;
  const made = `${formatCount(done)} of ${files(total)}`;
  const size = done > 0 ? `, ${formatBytes(bytes)}` : "";
  if (paused !== undefined && (state === "queued" || state === "running")) return `${made}, stands still: ${PAUSES[paused] ?? paused}`;
  switch (state) {
    case "queued":
      return `queued, ${files(total)}`;
    case "running":
      return made + (etaSeconds === undefined ? "" : `, about ${formatDuration(etaSeconds)} left`);
    case "done":
      return files(done) + size + withoutSurface(empty);
    case "cancelled":
      return `cancelled, ${made}${size}`;
    case "failed":
      return `failed, ${made}${size}: ${error?.detail ?? `${formatCount(failed)} could not be made`}`;
  }
}

/** What is said when a job was submitted. */
export function submittedText({ extractions, estimate }: JobInfo): string {
  return `The server makes ${files(extractions.total)}: up to ${formatBytes(estimate.bytes)}, about ${formatDuration(estimate.seconds)} when nobody else uses it`;
}

/** What is said when it has ended. */
export function finishedText({ volume: id, state, extractions }: JobInfo, volumes: Titles): string {
  const { done, empty } = extractions;
  const volume = titleOf(volumes, id);
  if (state === "done") return `${files(done)} of ${volume} ${done === 1 ? "is" : "are"} ready${withoutSurface(empty)}`;
  return `The batch job of ${volume} ${state === "failed" ? "has failed" : "was cancelled"}`;
}
