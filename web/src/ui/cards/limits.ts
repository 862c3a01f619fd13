/** What keeps the surface from being finer or coarser, in words, and the edits that end it. Pure. */

import type { Curve, Edit, PixelError, Statistics, View } from "../../protocol/types";
import { followsCamera } from "../../protocol/view";
import type { LengthScale } from "../../state/lengths";
import { formatCount, formatLength, formatValue } from "../format";
import { FINE_ERROR, trianglesFor } from "../plots/errorCurve";
import { criterion, gaveWayText, inSpacings } from "./criterion";
import { FIRST_ERROR } from "./errorUnits";

export interface Limit {
  readonly text: string;
  /** What its button says and does. */
  readonly lift?: { readonly text: string; readonly edit: Edit };
}

/** The server's refusal of the values in force. */
interface Refusal {
  readonly code: string;
  readonly suggestedTriangles?: number;
}

/** The budget if no other surface has one. */
const FIRST_BUDGET: Edit = { triangles: { share: 0.25 } };

/**
 * @param budget the edit that lets a budget decide
 * @param curve of this surface, if it alone has the budget
 */
export function limitsOf(view: View, statistics: Statistics | undefined, refusal: Refusal | undefined, scale: LengthScale, budget: Edit = FIRST_BUDGET, curve?: Curve): readonly Limit[] {
  // There is nothing to limit.
  if (statistics?.fullTriangles === 0) return [];
  const found: (Limit | undefined)[] = [
    refusalLimit(refusal, view),
    betaLimit(view, budget),
    errorLimit(view, statistics, scale),
    budgetLimit(view, statistics, scale, curve),
    maximumLimit(view, statistics),
  ];
  return found.filter((limit) => limit !== undefined);
}

function refusalLimit(refusal: Refusal | undefined, view: View): Limit | undefined {
  const minimum = refusal?.suggestedTriangles;
  if (minimum === undefined) return undefined;
  if (refusal?.code === "too-large") {
    return { text: "The full surface has more triangles than this server makes", lift: { text: `Make ${formatCount(minimum)}`, edit: { triangles: minimum } } };
  }
  const text = `No surface with so few triangles is within the guards: the smallest has ${formatCount(minimum)}`;
  const isGuarded = view.topology === "preserve" || (view.maxError !== null && view.maxError !== "auto");
  if (!isGuarded) return { text, lift: { text: `Make ${formatCount(minimum)}`, edit: { triangles: minimum } } };
  return { text, lift: { text: "Relax limits", edit: { topology: "auto", maxError: "auto" } } };
}

function betaLimit(view: View, budget: Edit): Limit | undefined {
  if (view.beta === undefined) return undefined;
  return {
    text: view.beta < 0 ? "Nothing is merged: β is below 0" : `β = ${formatValue(view.beta, 3)} decides`,
    lift: { text: "Limit by triangles", edit: budget },
  };
}

/** Ends of the sentence about the error at this view. */
const PIXEL_LIMITS: Readonly<Record<PixelError["limitedBy"], string>> = {
  error: "as asked",
  budget: "the budget allows no finer",
  pixels: "finer would not show",
  guard: "the guard on the error is finer",
  data: "this is the full surface",
};

/** `0.83 px`; an error that cannot be seen has no digits. */
export function formatPixels(pixels: number): string {
  return pixels < 0.01 ? "less than 0.01 px" : `${formatValue(pixels, 2)} px`;
}

/** The error in the picture and what limits it, of a surface that follows the camera: always one item, as it changes with each move. */
export function pixelLimit(view: View, statistics: Statistics | undefined): Limit | undefined {
  if (!followsCamera(view) || statistics?.fullTriangles === 0) return undefined;
  const pixels = statistics?.pixels ?? undefined;
  if (pixels === undefined) return { text: "The error at this view is not known yet" };
  const { error, triangles } = view;
  const text = `Error up to about ${formatPixels(pixels.within)} at this view: ${PIXEL_LIMITS[pixels.limitedBy]}`;
  if (pixels.limitedBy === "budget") return { text, lift: { text: "Remove budget", edit: { error: error ?? FIRST_ERROR } } };
  if (pixels.limitedBy === "error" && triangles !== undefined) return { text, lift: { text: "Refine further", edit: { triangles } } };
  return { text };
}

/** An error and a budget: the greater tolerance decides. Here the error's. */
function errorLimit(view: View, statistics: Statistics | undefined, scale: LengthScale): Limit | undefined {
  const { error, triangles } = view;
  if (error === undefined || statistics === undefined || isAboutPixels(statistics) || criterion(view, statistics, scale.spacing) !== "error") return undefined;
  const text = formatLength(inSpacings(error, scale.spacing) * scale.spacing, scale);
  if (triangles === undefined) return { text: `Merged up to an error of ${text}` };
  return { text: `${text} reached with fewer triangles than the budget`, lift: { text: "Refine further", edit: { triangles } } };
}

/** Whether `pixelLimit` says what limits the surface. */
const isAboutPixels = ({ pixels }: Statistics): boolean => pixels !== null;

/** Guards that gave way to the budget, and an error that needs more triangles. */
function budgetLimit(view: View, statistics: Statistics | undefined, scale: LengthScale, curve: Curve | undefined): Limit | undefined {
  if (statistics === undefined) return undefined;
  const gaveWay = statistics.gaveWay.map((guard) => gaveWayText(guard, statistics, scale)).join(". ");
  const wanted = wantedLimit(view, statistics, scale, curve);
  if (wanted === undefined) return gaveWay === "" ? undefined : { text: `Limited by the budget. ${gaveWay}` };
  return { ...wanted, text: gaveWay === "" ? wanted.text : `${wanted.text}. ${gaveWay}` };
}

/** A budget that is reached before the view's error, or, without one, before an error that is hardly seen. */
function wantedLimit(view: View, statistics: Statistics, { spacing, unit }: LengthScale, curve: Curve | undefined): Limit | undefined {
  const { error, triangles } = view;
  if (triangles === undefined || isAboutPixels(statistics) || criterion(view, statistics, spacing) !== "triangles") return undefined;
  const length = (error === undefined ? FINE_ERROR : inSpacings(error, spacing)) * spacing;
  const needed = curve?.byError === true ? trianglesFor(curve.points, length, "threshold") : undefined;
  const text = formatLength(length, { spacing, unit });
  // Without a curve the tolerance says whether the error needs more.
  if (needed === undefined) return error === undefined && !((statistics.tolerance ?? 0) > length) ? undefined : { text: `${text} needs more triangles`, lift: { text: "Remove budget", edit: { error: error ?? `${FINE_ERROR}vx` } } };
  const count = roundedUp(needed);
  if (count <= statistics.triangles) return undefined;
  const edit: Edit = { triangles: count, ...(error === undefined ? {} : { error }) };
  return { text: `${text} needs ${formatCount(count)} triangles`, lift: { text: `Use ${formatCount(count)}`, edit } };
}

/** To two digits, and a little more than the curve says, whose points are not exact. */
function roundedUp(count: number): number {
  const unit = 10 ** Math.max(0, Math.floor(Math.log10(count)) - 1);
  return Math.ceil((1.02 * count) / unit) * unit;
}

function maximumLimit({ triangles, error }: View, statistics: Statistics | undefined): Limit | undefined {
  if (typeof triangles !== "object" || triangles.max === undefined || statistics === undefined) return undefined;
  if (triangles.share * statistics.fullTriangles <= triangles.max) return undefined;
  const edit: Edit = { triangles: { share: triangles.share }, ...(error === undefined ? {} : { error }) };
  return { text: `Capped at ${formatCount(triangles.max)} for speed`, lift: { text: "Remove cap", edit } };
}
