import { describe, expect, test } from "vitest";
import type { Vec3 } from "../src/protocol/types";
import { choosePart, MAX_PARTS, partsText, placesOf, readParts, withoutPlace, type Parts } from "../src/state/parts";
import { offersParts, partsNote, partsWords } from "../src/ui/cards/partTools";
import { hintText } from "../src/ui/words";
import { complete } from "../src/protocol/view";
import { NOTHING_KNOWN } from "./acting";
import { OPENING, statistics, VOLUMES } from "./fixture";

const A: Vec3 = [1, 2, 3];
const B: Vec3 = [4, 5, 6];

describe("parts that are chosen", () => {
  const none = { places: [], numbers: [] };
  /** Parts whose numbers are those of their places' first coordinates. */
  const kept = (...places: Vec3[]) => ({ places, numbers: places.map(([x]) => x) });
  const part = (at: Vec3, number: number | null = at[0]) => ({ at, number });

  test("are hidden one by one, or kept alone", () => {
    expect(choosePart(null, "hide-part", part(A), none)).toEqual({ hide: [A] });
    expect(choosePart({ hide: [A] }, "hide-part", part(B), none)).toEqual({ hide: [A, B] });
    expect(choosePart({ hide: [A] }, "keep-part", part(B), none)).toEqual({ keep: [B] });
    expect(choosePart({ keep: [A] }, "keep-part", part(B), kept(A))).toEqual({ keep: [B] });
  });

  test("are kept beside others, each once", () => {
    expect(choosePart(null, "keep-another", part(B), kept(A))).toEqual({ keep: [A, B] });
    expect(choosePart(null, "keep-another", part([9, 9, 9], A[0]), kept(A))).toMatch(/^This part is kept already/);
    const full = Array.from({ length: MAX_PARTS }, (): Vec3 => A);
    expect(choosePart(null, "keep-another", part(B), kept(...full.slice(1)))).toEqual({ keep: [...full.slice(1), B] });
    expect(choosePart(null, "keep-another", part(B), kept(...full))).toMatch(/^64 parts are kept/);
  });

  test("that are kept are hidden wherever they are clicked, but for the last", () => {
    const keep = { keep: [A, B] };
    expect(choosePart(keep, "hide-part", part([9, 9, 9], A[0]), kept(A, B))).toEqual({ keep: [B] });
    expect(choosePart({ keep: [A] }, "hide-part", part(A), kept(A))).toMatch(/^This is the only part/);
    // A server that does not number parts, and a place at which there is none now.
    expect(choosePart(keep, "hide-part", part(A, null), { places: keep.keep, numbers: [null, null] })).toMatch(/show all before/);
    expect(choosePart(keep, "hide-part", part(A), { places: keep.keep, numbers: [1, null] })).toEqual({ keep: [B] });
  });

  test("are at most as many as the server takes", () => {
    const full = { hide: Array.from({ length: MAX_PARTS }, (): Vec3 => A) };
    expect(choosePart({ hide: full.hide.slice(1) }, "hide-part", part(A), none)).toEqual(full);
    expect(choosePart(full, "hide-part", part(B), none)).toMatch(/^64 parts are hidden/);
  });

  test("are shown again one by one, and without any all are", () => {
    expect(withoutPlace({ hide: [A, B] }, 0)).toEqual({ hide: [B] });
    expect(withoutPlace({ keep: [A, B] }, 1)).toEqual({ keep: [A] });
    expect(withoutPlace({ hide: [A] }, 0)).toBeNull();
    expect(withoutPlace({ keep: [A] }, 0)).toBeNull();
  });

  test("come back from a link", () => {
    for (const parts of [null, { hide: [A] }, { keep: [A, B] }] as Parts[]) expect(readParts(partsText(parts), "parts")).toEqual(parts);
    expect(partsText({ hide: [A, B] })).toBe("hide:1,2,3;4,5,6");
    expect(placesOf(null)).toEqual([]);
  });

  test("are offered where the vertex tree is cut and the server can be asked", () => {
    expect(offersParts(OPENING, ["probe"])).toBe(true);
    expect(offersParts(OPENING, ["curve"])).toBe(false);
    expect(offersParts({ ...OPENING, ...complete({ beta: 0.1 }) }, ["probe"])).toBe(false);
    expect(offersParts({ ...OPENING, mesher: "marching-cubes" }, ["probe"])).toBe(false);
    expect(offersParts(undefined, ["probe"])).toBe(false);
  });

  test("are counted in words", () => {
    expect([{ hide: [A] }, { hide: [A, B] }, { keep: [A] }].map(partsWords)).toEqual(["1 part hidden", "2 parts hidden", "1 part kept, all others hidden"]);
  });

  test("say what is not as it was chosen", () => {
    const cut = { ...statistics(100), isTreeCut: true };
    expect(partsNote(null, cut)).toBe("");
    expect(partsNote({ hide: [A] }, undefined)).toBe("");
    expect(partsNote({ hide: [A] }, { ...cut, unmatchedPositions: 0 })).toBe("");
    expect(partsNote({ hide: [A, B] }, { ...cut, unmatchedPositions: 1 })).toBe("At one of these places there is no surface now");
    expect(partsNote({ hide: [A, B] }, { ...cut, unmatchedPositions: 2 })).toBe("At 2 of these places there is no surface now");
    expect(partsNote({ hide: [A] }, { ...cut, isTreeCut: false })).toMatch(/^All parts are shown until/);
  });

  test("explain a picture without a surface", () => {
    const open = { ...NOTHING_KNOWN, connection: "connected" as const, volume: VOLUMES[0], shown: { generation: 1, level: 0, final: true } };
    const hint = (parts: Parts, unmatchedPositions: number) => hintText({ ...open, view: { ...OPENING, parts }, statistics: { ...statistics(0), removedParts: 2, unmatchedPositions } }, false);
    expect(hint({ hide: [A, B] }, 0)).toMatch(/^All parts are hidden/);
    expect(hint({ keep: [A] }, 1)).toMatch(/^At the places that you kept there is no surface now/);
  });
});
