/** Parts of the surface, pieces that nothing connects, which are hidden or kept alone: each chosen by a place on it. Pure. */

import type { Vec3, View } from "../protocol/types";
import { LinkError, toNumbers } from "./linkReader";
import { list } from "./numbers";

/** All are shown, or all but some, or some alone. */
export type Parts = View["parts"];

export type PartTool = "hide-part" | "keep-part" | "keep-another";

/** Steps on the way to one choice are one of the history. */
export const PARTS_GESTURE = "parts";

/** As many as the server takes. */
export const MAX_PARTS = 64;

/** Places at which parts were chosen. */
export function placesOf(parts: Parts): readonly Vec3[] {
  if (parts === null) return [];
  return "hide" in parts ? parts.hide : parts.keep;
}

export const isKept = (parts: Parts): boolean => parts !== null && "keep" in parts;

/** A part that was clicked: its place, and its number; `null` if the server does not say. */
interface ChosenPart {
  readonly at: Vec3;
  readonly number: number | null;
}

/** Parts that were chosen before: their places, and their numbers, `null` if there is no part now. */
interface KeptParts {
  readonly places: readonly Vec3[];
  readonly numbers: readonly (number | null)[];
}

/**
 * Hides the part that was clicked too, or keeps it, alone or beside others; or a sentence that says why not.
 * @param kept those that are kept, or were while another one is being chosen
 */
export function choosePart(parts: Parts, tool: PartTool, { at, number }: ChosenPart, { places, numbers }: KeptParts): NonNullable<Parts> | string {
  if (tool === "keep-part") return { keep: [at] };
  if (tool === "keep-another") {
    if (number !== null && numbers.includes(number)) return "This part is kept already: click another one";
    return places.length < MAX_PARTS ? { keep: [...places, at] } : `${MAX_PARTS} parts are kept, and no more can be`;
  }
  if (isKept(parts)) {
    const keep = places.filter((_, i) => number === null || numbers[i] !== number);
    if (keep.length === places.length) return "Only the parts that you kept are shown: show all before you hide one";
    return keep.length > 0 ? { keep } : "This is the only part that is shown: show all before you hide it";
  }
  const hide = [...placesOf(parts), at];
  return hide.length <= MAX_PARTS ? { hide } : `${MAX_PARTS} parts are hidden, and no more can be: show some again`;
}

/** Without the choice at a place of the list. */
export function withoutPlace(parts: Parts, index: number): Parts {
  const places = placesOf(parts).toSpliced(index, 1);
  if (places.length === 0) return null;
  return isKept(parts) ? { keep: places } : { hide: places };
}

/** In a link. */
export function partsText(parts: Parts): string {
  if (parts === null) return "all";
  return `${isKept(parts) ? "keep" : "hide"}:${placesOf(parts).map(list).join(";")}`;
}

/** @throws LinkError naming what was wrong */
export function readParts(text: string, name: string): Parts {
  if (text === "all") return null;
  const [mode = "", places = ""] = text.split(":");
  if ((mode !== "hide" && mode !== "keep") || places === "") throw new LinkError(`This link's “${name}” is ${JSON.stringify(text)}, expected all, or hide: or keep: and places`);
  const read = places.split(";").map((place) => toNumbers(name, place, [3]) as unknown as Vec3);
  return mode === "hide" ? { hide: read } : { keep: read };
}
