/** Parts of the surface, pieces that nothing connects, which are hidden or kept alone: each chosen by a place on it. Pure. */

import type { Vec3, View } from "../protocol/types";
import { LinkError, toNumbers } from "./linkReader";
import { list } from "./numbers";

/** All are shown, or all but some, or some alone. */
export type Parts = View["parts"];

export type PartTool = "hide-part" | "keep-part";

/** As many as the server takes. */
export const MAX_PARTS = 64;

/** Where parts were chosen. */
export function placesOf(parts: Parts): readonly Vec3[] {
  if (parts === null) return [];
  return "hide" in parts ? parts.hide : parts.keep;
}

const isKept = (parts: Parts) => parts !== null && "keep" in parts;

/** Hides the part at a place too, or keeps it alone; or a sentence that says why not. */
export function choosePart(parts: Parts, tool: PartTool, at: Vec3): NonNullable<Parts> | string {
  if (tool === "keep-part") return { keep: [at] };
  if (isKept(parts)) return "Only the parts that you kept are shown: show all before you hide one";
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
