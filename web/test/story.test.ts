import { describe, expect, test } from "vitest";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { isInLink, moved, readStoryText, storyText, withText, type Story } from "../src/state/story";
import { poseBetween, readingSeconds } from "../src/state/storyMoves";
import { readStoryFile, storyFile } from "../src/state/storyFile";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { OPENING } from "./fixture";

const STORY: Story = [
  { text: "Far away, & ~ near; 50 %", state: "v=1&volume=ball&iso=1" },
  { text: "", state: "v=1&volume=ball&iso=2&camera=1,2,3,0,0,0" },
];

describe("a story as a file", () => {
  test("is read as it was saved", () => {
    expect(readStoryFile(storyFile(STORY), decodeLink)).toEqual(STORY);
    expect(JSON.parse(storyFile(STORY))).toMatchObject({ format: "isopeel-story", version: 1 });
  });

  test.each([
    ["no JSON", "The file is no JSON, expected a story that isopeel has saved"],
    ["[]", "its “format” is missing, expected \"isopeel-story\""],
    ['{"format":"x"}', 'its “format” is "x"'],
    ['{"format":"isopeel-story","version":2,"bookmarks":[]}', "The story has version 2, which this page does not know. It knows 1"],
    ['{"format":"isopeel-story","version":1}', "“bookmarks” is missing, expected a list"],
    ['{"format":"isopeel-story","version":1,"bookmarks":[7]}', "Bookmark 1 has the text missing"],
    ['{"format":"isopeel-story","version":1,"bookmarks":[{"text":"a"}]}', "Bookmark 1 has the state missing"],
    ['{"format":"isopeel-story","version":1,"bookmarks":[{"text":"a","state":"iso=3"}]}', "Bookmark 1 cannot be shown: it names no volume"],
    ['{"format":"isopeel-story","version":1,"bookmarks":[{"text":"a","state":"volume=a&iso=x"}]}', "Bookmark 1 cannot be shown: This link's “iso” is \"x\", expected a number"],
  ])("says what is wrong with %s", (text, reason) => expect(() => readStoryFile(text, decodeLink)).toThrow(reason));

  test("is bounded", () => {
    const many = Array.from({ length: 101 }, () => STORY[0]!);
    expect(() => readStoryFile(storyFile(many), decodeLink)).toThrow("The story has 101 bookmarks, expected 100 at most");
    expect(() => readStoryFile(storyFile([{ text: "a".repeat(301), state: "volume=a" }]), decodeLink)).toThrow("expected one of 300 characters at most");
  });
});

describe("a story in a link", () => {
  const state = { volume: "ball", step: 0, surfaces: [{ number: 0, view: OPENING, style: DEFAULT_STYLE }], selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined };

  test("is read as it was written", () => {
    expect(decodeLink(encodeLink({ ...state, story: STORY }))?.story).toEqual(STORY);
    expect(decodeLink(encodeLink(state))).not.toHaveProperty("story");
  });

  test("is left out if it is long", () => {
    const long = Array.from({ length: 90 }, () => STORY[1]!);
    expect([isInLink(STORY), isInLink([]), isInLink(long), storyText(long)]).toEqual([true, true, false, undefined]);
    expect(encodeLink({ ...state, story: long })).not.toContain("story");
  });

  test("that was cut off is answered with a sentence", () => {
    expect(() => decodeLink("volume=a&story=abc")).toThrow("This link's “story” cannot be read");
    expect(() => readStoryText("%E0%A4%A~x")).toThrow("This link's “story” cannot be read: it was cut off or changed");
  });
});

test("bookmarks are moved and their sentences changed", () => {
  expect(moved(STORY, 0, 1)).toEqual([STORY[1], STORY[0]]);
  expect(moved(STORY, 0, 2)).toBe(STORY);
  expect(withText(STORY, 1, "b")[1]).toEqual({ ...STORY[1], text: "b" });
  expect(readingSeconds("")).toBe(2.5);
  expect(readingSeconds("word ".repeat(15))).toBe(6);
  expect(readingSeconds("word ".repeat(999))).toBe(12);
});

describe("the camera between two bookmarks", () => {
  const from = { position: [10, 0, 0], target: [0, 0, 0] } as const;
  const distance = ({ position, target }: { readonly position: readonly number[]; readonly target: readonly number[] }) => Math.hypot(...position.map((p, i) => p - (target[i] ?? 0)));

  test("begins at the one and ends at the other", () => {
    const to = { position: [0, 30, 5], target: [1, 2, 3] } as const;
    for (const [t, pose] of [[0, from], [1, to]] as const) {
      const found = poseBetween(from, to, t);
      [...found.position, ...found.target].forEach((n, i) => expect(n).toBeCloseTo([...pose.position, ...pose.target][i]!));
    }
  });

  test("turns around what it looks at, the shorter way, and does not pass through it", () => {
    const to = { position: [-10, -0.1, 0], target: [0, 0, 0] } as const;
    for (const t of [0.2, 0.5, 0.8]) {
      const pose = poseBetween(from, to, t);
      expect(distance(pose)).toBeCloseTo(10, 1);
      expect(pose.position[1]).toBeLessThan(0);
    }
  });

  test("comes nearer by equal factors", () => {
    const to = { position: [0.1, 0, 0], target: [0, 0, 0] } as const;
    expect(distance(poseBetween(from, to, 0.5))).toBeCloseTo(1);
  });
});
