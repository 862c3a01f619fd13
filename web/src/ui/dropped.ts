/** Files that a user drops on the page or chooses, those in folders too, with the names that are sent to the server. */

import type { NamedFile } from "../net/uploads";

/** What systems leave in folders. */
const LITTER = new Set([".DS_Store", "Thumbs.db", "desktop.ini"]);

/** Whether something that is dragged over the page is files. */
export function hasFiles(transfer: DataTransfer | null): boolean {
  return transfer?.types.includes("Files") === true;
}

/** Must be called while the event is handled: the browser forgets the list afterwards. */
export function droppedFiles(transfer: DataTransfer): Promise<readonly NamedFile[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry() ?? item.getAsFile());
  return Promise.all(entries.map(filesOf)).then((files) => tidy(files.flat()));
}

/** Of an input, whose folders are in the names. */
export function chosenFiles(list: FileList | null): readonly NamedFile[] {
  return tidy([...(list ?? [])].map((file) => ({ name: file.webkitRelativePath || file.name, file })));
}

/** In the order of their names, so that the same files are the same upload. */
export function tidy(files: readonly NamedFile[]): readonly NamedFile[] {
  const kept = files.filter(({ name }) => !LITTER.has(name.slice(name.lastIndexOf("/") + 1)));
  return kept.sort((a, b) => (a.name < b.name ? -1 : a.name > b.name ? 1 : 0));
}

/** Of a file or folder; what was made by a script is no entry. */
async function filesOf(entry: FileSystemEntry | File | null): Promise<readonly NamedFile[]> {
  if (entry === null) return [];
  if (entry instanceof File) return [{ name: entry.name, file: entry }];
  if (entry.isFile) {
    const file = await new Promise<File>((found, failed) => (entry as FileSystemFileEntry).file(found, failed));
    return [{ name: entry.fullPath.replace(/^\//, ""), file }];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const files: NamedFile[] = [];
  // It hands out a hundred at a time.
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((found, failed) => reader.readEntries(found, failed));
    if (some.length === 0) return files;
    for (const inner of some) files.push(...(await filesOf(inner)));
  }
}
