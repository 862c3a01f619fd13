/**
 * The state of the page in the address: `#v=1&volume=ct-head&iso=517&share=0.2`. Names are those of edits, or shorter; what is not
 * named is as the volume opens. Names of a second surface begin with `s2.`, of a third with `s3.`. Pure.
 */

import type { Vec3, View } from "../protocol/types";
import { LinkError, Reader } from "./linkReader";
import type { Look, Pose } from "./look";
import { lookParts, readLook } from "./lookLink";
import { list } from "./numbers";
import { knows, openingLookOf, workOf, type State, type Wish } from "./state";
import { readSlicing, slicingParts, type Slicing } from "./slicing";
import { readStoryText, storyText, type Story } from "./story";
import { readSurface, surfaceParts } from "./surfaceLink";
import { MAX_SURFACES, type SurfaceList } from "./surfaceList";

const VERSION = 1;

export interface Link extends Wish {
  readonly volume: string;
  readonly step: number;
}

/** What a page knows when it makes a link. */
export interface LinkState {
  readonly volume: string;
  readonly step: number;
  readonly surfaces: SurfaceList;
  /** Number of the selected one. */
  readonly selected: number;
  /** With what the volume opened. */
  readonly opening: View;
  readonly look: Look;
  readonly openingLook: Look;
  readonly slicing?: Slicing;
  readonly story?: Story | undefined;
  readonly pose: Pose | undefined;
}

/** The state as a link has it; `undefined` until a volume is open that a link could name. */
export function linkState(state: State, pose: Pose | undefined): LinkState | undefined {
  const { opening, page: { slicing, story }, server: { target, volume } } = state;
  if (opening === undefined || volume === undefined || target?.volume !== volume.id) return undefined;
  return { volume: volume.id, ...workOf(state), opening, openingLook: openingLookOf(state), slicing, story, pose };
}

/** The volume that the server brings along, with a part that matters: what importance is for is seen at once. */
const DEMO = "v=1&volume=mni152&triangles=20000&tf=0,0,3f6f8c;1,0.1,7d2f35&roi=53.7,-26.7,33.5,23,0.95&color=importance&map=ylor&wire=1";

/** The first view of a volume that is opened without a link; `undefined`: as the server opens it, or as it was left. */
export function firstLink(state: State, volume: string): Link | undefined {
  const demo = decodeLink(DEMO);
  return knows(state, volume) || demo?.volume !== volume ? undefined : demo;
}

type Parts = readonly (readonly [string, string | undefined])[];

/** The address' hash, without `#`. */
export function encodeLink(state: LinkState): string {
  return written(linkParts(state));
}

/**
 * The link with other values: `null` means the value that the volume opens with. Of another volume nothing is kept.
 * @throws LinkError if a link has no such name
 */
export function changedLink(state: LinkState, values: ReadonlyMap<string, string | null>): string {
  const parts = new Map(linkParts(state));
  const ofSurface = new Set(state.surfaces.slice(0, 1).flatMap((surface) => surfaceParts(surface, state.opening).map(([name]) => name)));
  // A further surface has the names of the first.
  const unknown = [...values.keys()].find((name) => !parts.has(name) && !(/^s[2-4]\./.test(name) && ofSurface.has(name.slice(3))));
  if (unknown !== undefined) throw new LinkError(`A link has no “${unknown.slice(0, 40)}”. It has: ${[...parts.keys()].join(", ")}`);
  const isOther = (values.get("volume") ?? state.volume) !== state.volume;
  const kept: Parts = isOther ? [["v", String(VERSION)]] : [...parts];
  return written([...new Map([...kept, ...[...values].map(([name, value]) => [name, value ?? undefined] as const)])]);
}

/** All names of a link, with the values of those that are in this one. */
function linkParts({ volume, step, surfaces, selected, opening, look, openingLook, slicing, story = [], pose }: LinkState): Parts {
  const at = surfaces.findIndex(({ number }) => number === selected);
  return [
    ["v", String(VERSION)],
    ["volume", volume],
    ["step", step === 0 ? undefined : String(step)],
    ...surfaces.flatMap((surface, place) => surfaceParts(surface, opening).map(([name, value]) => [prefixOf(place) + name, value] as const)),
    ["surface", at > 0 ? String(at + 1) : undefined],
    ...lookParts(look, openingLook),
    ...slicingParts(slicing),
    ["story", storyText(story)],
    ["camera", pose && list([...pose.position, ...pose.target])],
  ];
}

function written(parts: Parts): string {
  return parts.flatMap(([name, value]) => (value === undefined ? [] : [`${name}=${escape(value)}`])).join("&");
}

/** The first surface has none: links are from when there was one alone. */
const prefixOf = (place: number) => (place === 0 ? "" : `s${place + 1}.`);

/** Characters that a hash may hold stay as they are, so that it can be read. */
const escape = (text: string) => encodeURIComponent(text).replaceAll("%2C", ",").replaceAll("%3B", ";").replaceAll("%3A", ":");

/**
 * What an address' hash asks for; `undefined` if it names no volume.
 * @throws LinkError naming what was wrong with it
 */
export function decodeLink(hash: string): Link | undefined {
  const values = new Map<string, string>();
  for (const part of hash.replace(/^#/, "").split("&")) {
    const at = part.indexOf("=");
    if (at > 0) values.set(part.slice(0, at), unescaped(part.slice(at + 1)));
  }
  const volume = values.get("volume");
  if (volume === undefined) return undefined;
  const read = new Reader(values);
  const version = read.number("v") ?? VERSION;
  if (version !== VERSION) throw new LinkError(`This link is of version ${version}, which this page does not know. It knows ${VERSION}`);
  const camera = read.numbers("camera", 6);
  const slicing = readSlicing(read);
  const story = read.text("story");
  return {
    volume,
    step: Math.max(0, Math.trunc(read.number("step") ?? 0)),
    surfaces: readSurfaces(values),
    selected: Math.max(0, Math.trunc(read.number("surface") ?? 1) - 1),
    look: readLook(read),
    ...(slicing === undefined ? {} : { slicing }),
    ...(story === undefined ? {} : { story: readStoryText(story) }),
    pose: camera && { position: camera.slice(0, 3) as unknown as Vec3, target: camera.slice(3) as unknown as Vec3 },
  };
}

/** The first surface, and the further ones up to the first that nothing is said of. */
function readSurfaces(values: ReadonlyMap<string, string>): Wish["surfaces"] {
  const named = (prefix: string) => new Map([...values].filter(([name]) => name.startsWith(prefix)).map(([name, value]) => [name.slice(prefix.length), value]));
  const all = Array.from({ length: MAX_SURFACES }, (_, place) => named(prefixOf(place)));
  const end = all.findIndex((of, place) => place > 0 && of.size === 0);
  return all.slice(0, end < 0 ? all.length : end).map((of, place) => readSurface(new Reader(of, prefixOf(place))));
}

function unescaped(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    throw new LinkError(`This link was cut off or changed: ${JSON.stringify(text.slice(0, 40))} is no part of one`);
  }
}
