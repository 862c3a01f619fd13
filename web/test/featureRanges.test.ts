import { expect, test } from "vitest";
import { withRanges } from "../src/state/featureRanges";
import { ofItsField } from "../src/state/fields";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { knownOfOne, NOTHING_KNOWN } from "./acting";
import { OPENING, statistics, VOLUMES } from "./fixture";

const linkOf = (view: typeof OPENING) =>
  encodeLink({ volume: "ball", step: 0, surfaces: [{ number: 0, view, style: DEFAULT_STYLE }], selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined });

test("a link with another feature has its range, though it be that of the opening", () => {
  const hash = linkOf({ ...OPENING, feature: "depth" });
  expect(hash).toContain("&feature=depth&range=");
  expect(decodeLink(hash)?.surfaces[0]?.edit.featureRange).toEqual(OPENING.featureRange);
});

test("a link with another feature and no range does not have that of the feature before", () => {
  const edit = ofItsField({ feature: "depth" }, OPENING, VOLUMES[0]);
  expect({ ...OPENING, ...edit }.featureRange).toBeUndefined();
  expect(ofItsField({ feature: OPENING.feature }, OPENING, VOLUMES[0])).not.toHaveProperty("featureRange");
});

test("a range that the server has chosen is the one of the colours", () => {
  const surfaces = [{ number: 0, view: { ...OPENING, feature: "depth", featureRange: undefined }, style: DEFAULT_STYLE }];
  expect(withRanges(NOTHING_KNOWN, surfaces)[0]?.view.featureRange).toBeUndefined();
  const done = knownOfOne({ statistics: { ...statistics(9), featureRange: [2, 7] } });
  expect(withRanges(done, surfaces)[0]?.view.featureRange).toEqual([2, 7]);
  const given = { number: 0, view: { ...OPENING, featureRange: [0, 1] as const }, style: DEFAULT_STYLE };
  expect(withRanges(done, [given])[0]?.view.featureRange).toEqual([0, 1]);
});
