/** A story as a file: JSON with a version. Pure. */

import { checked, shown, StoryError, type Story } from "./story";

/** Larger files are not stories of this page. */
export const MAX_FILE_BYTES = 4_000_000;

const FORMAT = "isopeel-story";
const VERSION = 1;

export function storyFile(story: Story): string {
  return `${JSON.stringify({ format: FORMAT, version: VERSION, bookmarks: story }, null, 2)}\n`;
}

/**
 * @param decode reads the state of a bookmark, and throws if it is wrong
 * @throws StoryError naming what was found, and what is expected
 */
export function readStoryFile(text: string, decode: (state: string) => unknown): Story {
  let file: unknown;
  try {
    file = JSON.parse(text);
  } catch {
    throw new StoryError("The file is no JSON, expected a story that isopeel has saved");
  }
  const { format, version, bookmarks } = (typeof file === "object" && file !== null ? file : {}) as Readonly<Record<string, unknown>>;
  if (format !== FORMAT) throw new StoryError(`The file is no story: its “format” is ${shown(format)}, expected ${JSON.stringify(FORMAT)}`);
  if (version !== VERSION) throw new StoryError(`The story has version ${shown(version)}, which this page does not know. It knows ${VERSION}`);
  if (!Array.isArray(bookmarks)) throw new StoryError(`The story's “bookmarks” is ${shown(bookmarks)}, expected a list`);
  const story = checked(bookmarks);
  story.forEach(({ state }, i) => checkState(`Bookmark ${i + 1}`, state, decode));
  return story;
}

function checkState(where: string, state: string, decode: (state: string) => unknown): void {
  let found: unknown;
  try {
    found = decode(state);
  } catch (error) {
    throw new StoryError(`${where} cannot be shown: ${error instanceof Error ? error.message : String(error)}`);
  }
  if (found === undefined) throw new StoryError(`${where} cannot be shown: it names no volume`);
}
