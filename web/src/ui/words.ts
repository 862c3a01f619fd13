/** Sentences about the surface and the connection. Pure. */

import type { ServerMessage, Statistics, View } from "../protocol/types";
import { allTriangles } from "../state/counts";
import type { Distances } from "../state/distances";
import type { LengthScale } from "../state/lengths";
import type { awaitedErrors } from "../state/shownErrors";
import type { SurfaceList } from "../state/surfaceList";
import type { SurfaceState } from "../state/surfaceState";
import type { ViewerState } from "../state/viewer";
import type { Uploading } from "./model";
import { surfaceName } from "./surfaceNames";
import { digitsBetween, formatBytes, formatCount, formatLength, formatMs, formatPercent, formatShare, formatValue } from "./format";
import { hasValues } from "./plots/histogram";

/** How far surfaces are off, with what is known of each: a full triangle is about an equal area, whatever its surface. */
function overallError(all: readonly ErrorsOf[]): { readonly rms: number; readonly isEstimate: boolean } | undefined {
  const some = all.filter(({ fullTriangles }) => fullTriangles > 0);
  const known = some.flatMap(({ error, estimatedError, fullTriangles }) => {
    const rms = error?.rms ?? estimatedError?.rms;
    return rms === undefined ? [] : [{ square: fullTriangles * rms ** 2, fullTriangles }];
  });
  if (known.length < Math.max(1, some.length)) return undefined;
  const sum = (of: "square" | "fullTriangles") => known.reduce((total, one) => total + one[of], 0);
  return { rms: Math.sqrt(sum("square") / sum("fullTriangles")), isEstimate: some.some(({ error }) => error === null) };
}

type ErrorsOf = Pick<Statistics, "error" | "estimatedError" | "fullTriangles">;

/** `error ≈ 0.11 voxels (RMS)`, of all surfaces together; with ≈ while some is an estimate. `undefined` if something is not known. */
export function errorWords(all: readonly ErrorsOf[], scale: LengthScale): string | undefined {
  const error = overallError(all);
  return error && `error ${error.isEstimate ? "≈ " : ""}${formatLength(error.rms, scale)} (RMS)`;
}

/** What the colours of distances mean. */
export function distanceWords({ share, upper, farthest }: Distances, measured: readonly (Statistics["error"] | undefined)[], scale: LengthScale): string {
  const darkest = `Darkest: error ${formatLength(upper, scale)}`;
  const max = measured.reduce<number | undefined>((max, error) => (max === undefined || error === undefined || error === null ? undefined : Math.max(max, error.max)), 0);
  const end = max === undefined || measured.length === 0 ? "" : `; the measured maximum is ${formatLength(max, scale)}`;
  return farthest <= upper ? `${darkest}${end}` : `${darkest} and more, around ${formatShare(1 - share)} of the vertices${end}`;
}

/** Why the colours do not show the error; empty if there is no surface that it could be of. */
export function awaitedWords(state: ReturnType<typeof awaitedErrors>): string {
  if (state === "measuring") return "The error is being measured";
  return state === "unknown" ? "This server does not measure the error of vertices" : "";
}

/** Seconds, as a person says them. */
export function formatSeconds(ms: number): string {
  return ms < 950 ? `${Number((ms / 1000).toPrecision(1))} s` : `${Number((ms / 1000).toPrecision(2))} s`;
}

export interface Summary {
  /** The surface in words; empty while there is none. */
  readonly parts: readonly string[];
  /** What goes on; empty while nothing does. */
  readonly activity: string;
}

/**
 * The top line: `87,501 of 454,932 triangles (19 %)`, `error ≈ 0.11 voxels (RMS)`, `0.2 s`; before it `2 surfaces` if there is more than
 * one.
 */
export function summaryOf(state: ViewerState, triangles: number, busy: boolean, scale: LengthScale): Summary {
  return { parts: surfaceParts(state, triangles, busy, scale), activity: activity(state, busy) };
}

function surfaceParts(state: ViewerState, triangles: number, busy: boolean, scale: LengthScale): string[] {
  const all = [...state.known.values()];
  if (all.every(({ shown }) => shown === undefined)) return [];
  const several = all.length > 1 ? [`${all.length} surfaces`] : [];
  const known = all.flatMap(({ shown, statistics }) => (shown?.final === true && statistics !== undefined ? [statistics] : []));
  if (busy || known.length < all.length) return triangles === 0 ? [] : [...several, `${formatCount(triangles)} triangles so far`];
  const full = known.reduce((sum, one) => sum + allTriangles(one), 0);
  const count = countWords(triangles, full);
  const error = triangles === 0 ? undefined : errorWords(known, scale);
  const ms = lastMs(all);
  return [...several, count, ...(error === undefined ? [] : [error]), ...(ms === undefined ? [] : [formatSeconds(ms)])];
}

/**
 * `87,501 of 454,932 triangles (19 %)`. If only the full surface of marching cubes was counted, that of the dual mesher has some more or
 * less: a surface with at least as many triangles counts as the full one.
 */
export function countWords(triangles: number, full: number): string {
  if (full <= 0) return `${formatCount(triangles)} triangles`;
  return triangles >= full ? `${formatCount(triangles)} triangles (all)` : `${formatCount(triangles)} of ${formatCount(full)} triangles (${formatShare(triangles / full)})`;
}

/** From the last edit to the last final picture that it made. */
function lastMs(all: readonly SurfaceState[]): number | undefined {
  const made = all.flatMap(({ progress }) => (progress === undefined ? [] : [progress]));
  const last = Math.max(...made.map(({ startedAt }) => startedAt));
  const times = made.flatMap(({ startedAt, lastMs }) => (startedAt === last && lastMs !== undefined ? [lastMs] : []));
  return times.length === 0 ? undefined : Math.max(...times);
}

function activity({ connection, openedShare, preparing, opening }: ViewerState, busy: boolean): string {
  if (connection === "waiting") return "Reconnecting";
  if (connection === "connecting") return "Connecting";
  if (connection === "stopped") return "Disconnected";
  if (preparing !== undefined) return preparingText(preparing);
  if (openedShare !== undefined) return `Opening, ${formatPercent(openedShare)}`;
  if (opening) return "Opening";
  return busy ? "Working" : "";
}

function preparingText({ done, of }: NonNullable<ViewerState["preparing"]>): string {
  return `Preparing the device, ${done} of ${of}`;
}

/** Rows of the popover behind the top line. */
export function statusRows(state: ViewerState): readonly (readonly [string, string])[] {
  const { progress, shown } = state;
  const ms = (value: number | undefined) => (value === undefined ? "–" : formatMs(value));
  return [
    ["First picture after the edit", ms(progress?.firstMs)],
    ["Final picture after the edit", ms(progress?.lastMs)],
    ["Received for this edit", formatBytes(progress?.bytes ?? 0)],
    ["Received since the page was opened", formatBytes(state.bytesReceived)],
    ["Edits taken up (generation)", shown === undefined ? "–" : String(shown.generation)],
    ["Level of the surface on screen", shown === undefined ? "–" : shown.final ? `${shown.level}, final` : String(shown.level)],
    ["Device", state.device ?? "–"],
  ];
}

/** Why there is no surface; empty if there is one, or one is not due. */
export function hintText(state: ViewerState, busy: boolean): string {
  const { connection, shown, target, view, volumes } = state;
  if (volumes?.length === 0) return "There are no volumes here. Drop files on the page, or start the server with some: isopeel serve head.nrrd";
  if (state.preparing !== undefined) return `${preparingText(state.preparing)}: this happens once for each driver`;
  if (state.opening) return `Opening ${volumes?.find((v) => v.id === target?.volume)?.title ?? target?.volume ?? ""}`;
  if (connection !== "connected") return state.volume === undefined ? "Connecting to the server" : "";
  if (state.volume === undefined) return state.refusal === undefined ? "" : "This volume could not be opened. Choose another one above";
  if (busy) return "Extracting the surface";
  if (state.refusal !== undefined) return "There is no surface for these values. Undo, or see Detail for what limits it";
  if (shown?.final === true && view !== undefined) return emptyText(state, view);
  return "";
}

function emptyText({ statistics, volume }: ViewerState, view: View): string {
  const { iso, mask, parts } = view;
  const minPart = view.minPart ?? 0;
  if (volume?.geometry.dims.some((n) => n < 2) === true) return "This volume is one sample thin: there is no cell for a surface to cross";
  if (parts !== null && (statistics?.removedParts ?? 0) > 0) {
    return "keep" in parts && statistics?.unmatchedPositions === parts.keep.length
      ? "At the places that you kept there is no surface now, and all else is hidden: show all under Surface"
      : "All parts are hidden: show some again under Surface";
  }
  if (minPart > 0 && (statistics?.removedParts ?? 0) > 0) return `All ${formatCount(statistics?.removedParts ?? 0)} parts are smaller than ${formatValue(minPart)}: lower that under Detail, Expert`;
  if (mask !== null) return `No surface at isovalue ${formatValue(iso)} where ${mask}: see Mask under Surface`;
  const field = volume?.fields.find(({ name }) => name === view.field);
  if (field !== undefined && !hasValues(field)) return "No sample has a value: there is no surface";
  const [low, high] = field?.range ?? [];
  if (low !== undefined && low === high) return `All values are ${formatValue(low)}: there is no surface`;
  const values = low === undefined || high === undefined ? "" : `. Values go from ${formatValue(low, digitsBetween(low, high))} to ${formatValue(high, digitsBetween(low, high))}`;
  return `No surface at isovalue ${formatValue(iso)}: no sample on one side of it${values}`;
}

/** An error of the server, with the surface that it is about if there are several. */
export function errorText({ message, surface }: Extract<ServerMessage, { type: "error" }>, surfaces: SurfaceList): string {
  const name = surfaceName(surfaces, surface);
  return name === "" ? message : `${name.charAt(0).toUpperCase()}${name.slice(1)}: ${message}`;
}

/** Why a link's surfaces are not all there. */
export function fewerText(count: number): string {
  return `This link has more surfaces than this server shows at once, which is ${count}: the others are left out`;
}

/** What an upload is doing. */
export function uploadText({ title, files, phase, sent, total }: Uploading): string {
  const what = files === 1 ? title : `${title}, ${formatCount(files)} files`;
  switch (phase) {
    case "declaring":
      return `Uploading ${what}: asking the server`;
    case "sending":
      return `Uploading ${what}: ${formatBytes(sent)} of ${formatBytes(total)}`;
    case "waiting":
      return `Uploading ${what}: the connection was lost, going on as soon as it is back`;
    case "reading":
      return `${what} is there and is being read`;
  }
}

/** Of a volume that was removed from the server while it was shown. */
export function removedText(title: string | undefined): string {
  return `${title === undefined ? "This volume" : `“${title}”`} was removed from the server, or has expired there`;
}

/** A link names a volume that is not on this server. `shown`: what is open instead, by its id. */
export function unknownVolumeText({ volumes }: Pick<ViewerState, "volumes">, id: string, shown: string | undefined): string {
  const instead = volumes?.find((volume) => volume.id === shown)?.title;
  return `There is no volume “${id}” on this server${instead === undefined ? "" : `. Shown instead: ${instead}`}`;
}
