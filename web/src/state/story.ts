/** Bookmarks: states of the page with a sentence each. In their order they are a story, which is played, and in links. Pure. */

import { LinkError } from "./linkReader";

export interface Bookmark {
  /** A sentence about what is seen; may be empty. */
  readonly text: string;
  /** As in an address, without `#`. */
  readonly state: string;
}

export type Story = readonly Bookmark[];

export const MAX_BOOKMARKS = 100;
export const MAX_SENTENCE = 300;
/** Longer stories are left out of links, which programs cut off. */
const MAX_LINK = 4000;
/** What was wrong with a file, for the user. */
export class StoryError extends Error {
  override readonly name = "StoryError";
}

/** Without what parts bookmarks. */
const escaped = (text: string) => encodeURIComponent(text).replaceAll("~", "%7E");

/** The story in a link: `undefined` if it has no bookmarks, or is too long. */
export function storyText(story: Story): string | undefined {
  if (story.length === 0) return undefined;
  const text = story.map((bookmark) => `${escaped(bookmark.text)}~${escaped(bookmark.state)}`).join("~~");
  return text.length > MAX_LINK ? undefined : text;
}

export const isInLink = (story: Story): boolean => story.length === 0 || storyText(story) !== undefined;

/** @throws LinkError naming what was wrong */
export function readStoryText(text: string): Story {
  try {
    const unescaped = text.split("~~").map((one) => one.split("~").map(decodeURIComponent));
    return checked(unescaped.map(([sentence, state]) => ({ text: sentence, state })));
  } catch (error) {
    throw new LinkError(`This link's “story” cannot be read: ${error instanceof StoryError ? error.message : "it was cut off or changed"}`);
  }
}

/** @throws StoryError naming which bookmark is wrong, and in what. Its state is looked at when it is shown. */
export function checked(bookmarks: readonly unknown[]): Story {
  if (bookmarks.length > MAX_BOOKMARKS) throw new StoryError(`The story has ${bookmarks.length} bookmarks, expected ${MAX_BOOKMARKS} at most`);
  return bookmarks.map((bookmark, i) => {
    const { text, state } = (typeof bookmark === "object" && bookmark !== null ? bookmark : {}) as Readonly<Record<string, unknown>>;
    const where = `Bookmark ${i + 1}`;
    if (typeof text !== "string" || text.length > MAX_SENTENCE) throw new StoryError(`${where} has the text ${shown(text)}, expected one of ${MAX_SENTENCE} characters at most`);
    if (typeof state !== "string") throw new StoryError(`${where} has the state ${shown(state)}, expected what stands behind # in an address`);
    return { text, state };
  });
}

/** What was found, in a message. */
export function shown(value: unknown): string {
  return value === undefined ? "missing" : JSON.stringify(value).slice(0, 40);
}

export function moved(story: Story, from: number, to: number): Story {
  const bookmark = story[from];
  return bookmark === undefined || to < 0 || to >= story.length ? story : story.toSpliced(from, 1).toSpliced(to, 0, bookmark);
}

export function withText(story: Story, at: number, text: string): Story {
  return story.map((bookmark, i) => (i === at ? { ...bookmark, text: text.slice(0, MAX_SENTENCE) } : bookmark));
}
