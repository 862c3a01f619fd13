/** Names of files that leave the page. Pure. */

import { digits } from "./numbers";

/** Ids of volumes that users bring: they tell a reader nothing. */
const UPLOADED = /^upload-/;
const MAX_CHARS = 80;

/** Letters and digits of any script, and what no system takes for something else. */
function safe(text: string): string {
  const name = text.trim().replaceAll(/[^\p{L}\p{N}.+-]+/gu, "_").replaceAll(/^[._]+|[._]+$/g, "").slice(0, MAX_CHARS);
  return name === "" ? "isopeel" : name;
}

/** A file's name for a volume: its id, as the command line has it, or the title of one that a user brings. */
export function volumeName(volume: { readonly id: string; readonly title: string } | undefined): string {
  if (volume === undefined) return "isopeel";
  return safe(UPLOADED.test(volume.id) ? volume.title : volume.id);
}

/** Of one surface: with its isovalue, or the labels that it is around. */
export function surfaceFileName(volume: Parameters<typeof volumeName>[0], iso: number, labels: string | undefined): string {
  return `${volumeName(volume)}-${labels === undefined ? digits(iso) : safe(labels)}`;
}
