/** Links that version 0.1 made, with what its page read of them: they open as they did. */

import { expect, test } from "vitest";
import { decodeLink } from "../src/state/link";
import links from "./links-0.1.json";

test.each(links)("$link", ({ link, read }) => {
  const found = decodeLink(link);
  // What later pages know beside it is theirs.
  expect(JSON.parse(JSON.stringify(found))).toMatchObject(read);
});

test("they have all that a link could say", () => {
  const names = new Set(links.flatMap(({ link }) => link.replace("#", "").split("&").map((part) => part.replace(/=.*/, ""))));
  expect(names.size).toBeGreaterThan(50);
});
