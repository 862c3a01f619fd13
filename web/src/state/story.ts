/** Bookmarks: states of the page with a sentence each. In their order they are a story, which is played, and in links. Pure. */

import { LinkError } from "./linkReader";
import type { Pose } from "./look";
import type { Vec3 } from "../protocol/types";

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

/** The story in a link: `undefined` where there is none, or it is too long. */
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

/** Seconds in which a sentence is read: some three words in a second. */
export function readingSeconds(text: string): number {
  const words = text.split(/\s+/).filter(Boolean).length;
  return Math.min(12, Math.max(2.5, 1 + words / 3));
}

const minus = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const length = (v: Vec3) => Math.hypot(...v);
const mix = (a: number, b: number, t: number) => a + (b - a) * t;
const mixed = (a: Vec3, b: Vec3, t: number): Vec3 => [mix(a[0], b[0], t), mix(a[1], b[1], t), mix(a[2], b[2], t)];

/** Between two poses: the camera turns around what it looks at, and begins and ends slowly. @param t 0 to 1 */
export function poseBetween(from: Pose, to: Pose, t: number): Pose {
  const eased = t * t * (3 - 2 * t);
  const target = mixed(from.target, to.target, eased);
  const [a, b] = [minus(from.position, from.target), minus(to.position, to.target)];
  const [la, lb] = [length(a), length(b)];
  if (!(la > 0) || !(lb > 0)) return t < 1 ? from : to;
  // By equal factors in equal times.
  const distance = la * (lb / la) ** eased;
  const [from2, to2] = [angles(a), angles(b)];
  const turn = ((((to2.around - from2.around + Math.PI) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI)) - Math.PI;
  const [around, up] = [from2.around + turn * eased, mix(from2.up, to2.up, eased)];
  const flat = distance * Math.cos(up);
  return { target, position: [target[0] + flat * Math.cos(around), target[1] + flat * Math.sin(around), target[2] + distance * Math.sin(up)] };
}

function angles(v: Vec3): { readonly around: number; readonly up: number } {
  return { around: Math.atan2(v[1], v[0]), up: Math.atan2(v[2], Math.hypot(v[0], v[1])) };
}
