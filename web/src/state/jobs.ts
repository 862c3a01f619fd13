/** Batch jobs, as far as the page reckons with them. Pure. */

import type { JobInfo } from "../protocol/types";

/** As many as a job may have. */
const MAX_ISOVALUES = 10_000;

/** Numbers with spaces, commas or semicolons between them; else what is wrong with the text. A comma within a word may be a decimal or a grouping one: only a list of several is plain. */
export function isovaluesOf(text: string): readonly number[] | string {
  const unclear = text.split(/[\s;]+|,(?=\s)/).find(isUnclear);
  if (unclear !== undefined) return `“${unclear}” can be one isovalue or two: write a decimal point, no groups, and a space between isovalues`;
  const words = text.split(/[\s,;]+/).filter((word) => word !== "");
  if (words.length === 0) return "Isovalues: expected a number, or some with spaces between them";
  if (words.length > MAX_ISOVALUES) return `${words.length} isovalues, expected at most ${MAX_ISOVALUES}`;
  const wrong = words.find((word) => !/^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(word) || !Number.isFinite(Number(word)));
  return wrong === undefined ? words.map(Number) : `“${wrong}” is no isovalue: expected numbers with spaces between them, such as 40 52.5`;
}

/** Digits on both sides of one comma, or in groups of three. */
const isUnclear = (word: string) => /^[+-]?\d+,\d+$/.test(word) || /^[+-]?\d{1,3}(,\d{3})+(\.\d*)?$/.test(word);

/** Nothing of it is to be done any more. */
export const isFinished = ({ state }: JobInfo) => state !== "queued" && state !== "running";

/** Those that were not finished in the list before, and are now. */
export function justFinished(before: readonly JobInfo[], now: readonly JobInfo[]): readonly JobInfo[] {
  const unfinished = new Set(before.filter((job) => !isFinished(job)).map(({ id }) => id));
  return now.filter((job) => unfinished.has(job.id) && isFinished(job));
}
