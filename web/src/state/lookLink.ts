/** The look in a link: names and values. Pure. */

import { isEqual } from "../protocol/equal";
import type { Vec3 } from "../protocol/types";
import { LinkError, toNumber, type Reader } from "./linkReader";
import { BACKGROUNDS, COLOR_BY, EXAGGERATIONS, levelOf, MAPS, MATERIALS, MAX_ISOLINES, NO_CLIP, NO_SLICES, NO_VOLUME, VOLUME_MODES, type ClipChoice, type Look, type SliceChoice, type VolumeChoice } from "./look";
import { MAX_MEASURES, measureText, readMeasure } from "./measure";
import { digits, list } from "./numbers";

/** Names in a link of what is on or off. */
const SWITCHES = {
  flat: "flat",
  wireframe: "wire",
  occlusion: "occlusion",
  silhouettes: "silhouettes",
  orthographic: "orthographic",
  logColors: "log",
  axes: "axes",
  scale: "scale",
  box: "bounds",
} as const;

/** Only what differs from how the volume opens. */
export function lookParts(look: Look, opening: Look): (readonly [string, string | undefined])[] {
  const differing = <K extends keyof Look>(name: K) => (isEqual(look[name], opening[name]) ? undefined : look[name]);
  const switches = Object.entries(SWITCHES).map(([name, short]) => {
    const value = differing(name as keyof typeof SWITCHES);
    return [short, value === undefined ? undefined : value ? "1" : "0"] as const;
  });
  const { clip, slices, measures } = look;
  const level = differing("finestLevel");
  return [
    ["color", differing("colorBy")],
    ["map", differing("map")],
    ["colors", look.colorRange && list(look.colorRange)],
    ["isolines", look.isolines === 0 ? undefined : String(look.isolines)],
    ["material", differing("material")],
    ...switches,
    ["heights", look.exaggeration === 1 ? undefined : digits(look.exaggeration)],
    ["peel", level === undefined ? undefined : String(level)],
    ["background", differing("background")],
    ["plane", clip.plane && list([...clip.plane.normal, clip.plane.offset])],
    ["clip", clip.box && list([...clip.box.min, ...clip.box.max])],
    ["caps", clip.caps ? undefined : "0"],
    ["slices", slices.planes.every((index) => index === null) ? undefined : slices.planes.map((index) => (index === null ? "" : digits(index))).join(",")],
    ["window", slices.window && list(slices.window)],
    ...volumeParts(look.volume),
    ["measure", measures.length === 0 ? undefined : measures.map(measureText).join(";")],
  ];
}

/** `vr`: volume rendering. */
function volumeParts({ mode, opacity, window, windowField, marksIso }: VolumeChoice): readonly (readonly [string, string | undefined])[] {
  return [
    ["vr", mode === NO_VOLUME.mode ? undefined : mode],
    ["vropacity", opacity === NO_VOLUME.opacity ? undefined : digits(opacity)],
    ["vrwindow", window && list(window)],
    ["vrfield", window && windowField],
    ["vrmark", marksIso === NO_VOLUME.marksIso ? undefined : "0"],
  ];
}

/** @throws LinkError naming what was wrong */
export function readLook(read: Reader): Partial<Look> {
  const level = read.number("peel");
  const found = {
    colorBy: oneOf(read, "color", COLOR_BY),
    map: oneOf(read, "map", MAPS),
    exaggeration: readExaggeration(read),
    colorRange: readRange(read, "colors"),
    isolines: readCount(read),
    material: oneOf(read, "material", MATERIALS),
    background: oneOf(read, "background", BACKGROUNDS),
    finestLevel: level === undefined ? undefined : levelOf(level),
    ...Object.fromEntries(Object.entries(SWITCHES).map(([name, short]) => [name, read.flag(short)])),
    clip: readClip(read),
    slices: readSlices(read),
    volume: readVolume(read),
    measures: read.list("measure", readMeasure)?.slice(0, MAX_MEASURES),
  };
  return Object.fromEntries(Object.entries(found).filter(([, value]) => value !== undefined));
}

function oneOf<T extends string>(read: Reader, name: string, known: readonly T[]): T | undefined {
  const text = read.text(name);
  if (text === undefined) return undefined;
  const found = known.find((one) => one === text);
  if (found === undefined) throw new LinkError(`This link's “${name}” is ${JSON.stringify(text)}, expected one of ${known.join(", ")}`);
  return found;
}

function readRange(read: Reader, name: string): readonly [number, number] | undefined {
  const [low, high] = read.numbers(name, 2) ?? [];
  if (low === undefined || high === undefined) return undefined;
  if (!(low < high)) throw new LinkError(`This link's “${name}” is ${low},${high}, expected a range from a lower to a higher value`);
  return [low, high];
}

function readVolume(read: Reader): VolumeChoice | undefined {
  const [mode, opacity, window, marksIso] = [oneOf(read, "vr", VOLUME_MODES), read.number("vropacity"), readRange(read, "vrwindow"), read.flag("vrmark")];
  if ([mode, opacity, window, marksIso].every((one) => one === undefined)) return undefined;
  if (opacity !== undefined && !(opacity >= 0 && opacity <= 1)) throw new LinkError(`This link's “vropacity” is ${opacity}, expected a number from 0 to 1`);
  const windowField = window && read.text("vrfield");
  return { mode: mode ?? NO_VOLUME.mode, opacity: opacity ?? NO_VOLUME.opacity, window, windowField, marksIso: marksIso ?? NO_VOLUME.marksIso };
}

function readExaggeration(read: Reader): number | undefined {
  const factor = read.number("heights");
  const { min, max } = EXAGGERATIONS;
  if (factor !== undefined && !(factor >= min && factor <= max)) throw new LinkError(`This link's “heights” is ${factor}, expected a factor from ${min} to ${max}`);
  return factor;
}

function readCount(read: Reader): number | undefined {
  const count = read.number("isolines");
  if (count !== undefined && !(Number.isInteger(count) && count >= 0 && count <= MAX_ISOLINES)) throw new LinkError(`This link's “isolines” is ${count}, expected a whole number up to ${MAX_ISOLINES}`);
  return count;
}

function readClip(read: Reader): ClipChoice | undefined {
  const [plane, box, caps] = [read.numbers("plane", 4), read.numbers("clip", 6), read.flag("caps")];
  if (plane === undefined && box === undefined && caps === undefined) return undefined;
  return { plane: plane && planeOf(plane), box: box && boxOf(box), caps: caps ?? NO_CLIP.caps };
}

function planeOf([x = 0, y = 0, z = 0, offset = 0]: readonly number[]): ClipChoice["plane"] {
  const length = Math.hypot(x, y, z);
  if (!(length > 0)) throw new LinkError("This link's “plane” has no direction, expected a normal and an offset");
  return { normal: [x / length, y / length, z / length], offset: offset / length };
}

function boxOf(numbers: readonly number[]): ClipChoice["box"] {
  const [low, high] = [numbers.slice(0, 3), numbers.slice(3)];
  const ordered = (pick: (a: number, b: number) => number) => low.map((n, axis) => pick(n, high[axis] ?? 0)) as unknown as Vec3;
  return { min: ordered(Math.min), max: ordered(Math.max) };
}

function readSlices(read: Reader): SliceChoice | undefined {
  const [planes, window] = [read.text("slices")?.split(","), read.numbers("window", 2)];
  if (planes === undefined && window === undefined) return undefined;
  if (planes !== undefined && planes.length !== 3) throw new LinkError(`This link's “slices” has ${planes.length} places, expected 3`);
  const index = (text: string | undefined) => (text === undefined || text === "" ? null : Math.max(0, Math.trunc(toNumber("slices", text))));
  return {
    planes: planes === undefined ? NO_SLICES.planes : [index(planes[0]), index(planes[1]), index(planes[2])],
    window: window && [window[0] ?? 0, window[1] ?? 0],
  };
}
