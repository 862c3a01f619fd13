/** What keeps the surface from being finer or coarser, in words, and the edits that end it. Pure. */

import type { Edit, Statistics, View } from "../../protocol/types";
import type { LengthScale } from "../../state/lengths";
import { formatCount, formatLength, formatValue } from "../format";
import { criterion, gaveWayText, inSpacings } from "./criterion";

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

/** Where no other surface has a budget. */
const FIRST_BUDGET: Edit = { triangles: { share: 0.25 } };

/** `budget`: the edit that lets a budget decide. */
export function limitsOf(view: View, statistics: Statistics | undefined, refusal: Refusal | undefined, scale: LengthScale, budget: Edit = FIRST_BUDGET): readonly Limit[] {
  // There is nothing to limit.
  if (statistics?.fullTriangles === 0) return [];
  const found: (Limit | undefined)[] = [
    refusalLimit(refusal, view),
    betaLimit(view, budget),
    errorLimit(view, statistics, scale),
    budgetLimit(view, statistics, scale),
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
  return { text, lift: { text: "Let the guards give way", edit: { topology: "auto", maxError: "auto" } } };
}

function betaLimit(view: View, budget: Edit): Limit | undefined {
  if (view.beta === undefined) return undefined;
  return {
    text: view.beta < 0 ? "Nothing is merged: β is below 0" : `β = ${formatValue(view.beta, 3)} decides`,
    lift: { text: "Decide by triangles", edit: budget },
  };
}

/** An error and a budget: the greater tolerance decides. Here the error's. */
function errorLimit(view: View, statistics: Statistics | undefined, scale: LengthScale): Limit | undefined {
  const { error, triangles } = view;
  if (error === undefined || statistics === undefined || criterion(view, statistics, scale.spacing) !== "error") return undefined;
  const text = `Merged up to an error of ${formatLength(inSpacings(error, scale.spacing) * scale.spacing, scale)}`;
  return triangles === undefined ? { text } : { text: `${text}, which needs no more triangles`, lift: { text: "Use more", edit: { triangles } } };
}

/** The budget's tolerance, and the guards that gave way to it. */
function budgetLimit(view: View, statistics: Statistics | undefined, scale: LengthScale): Limit | undefined {
  if (statistics === undefined) return undefined;
  const { error } = view;
  const gaveWay = statistics.gaveWay.map((guard) => gaveWayText(guard, statistics, scale));
  const decides = error !== undefined && criterion(view, statistics, scale.spacing) === "triangles";
  if (gaveWay.length === 0 && !decides) return undefined;
  const wanted = error === undefined ? "" : `Within ${formatLength(inSpacings(error, scale.spacing) * scale.spacing, scale)} it takes more`;
  const text = gaveWay.length > 0 ? gaveWay.join(". ") : wanted;
  return decides ? { text, lift: { text: "Allow more", edit: { error } } } : { text };
}

function maximumLimit({ triangles, error }: View, statistics: Statistics | undefined): Limit | undefined {
  if (typeof triangles !== "object" || triangles.max === undefined || statistics === undefined) return undefined;
  if (triangles.share * statistics.fullTriangles <= triangles.max) return undefined;
  const edit: Edit = { triangles: { share: triangles.share }, ...(error === undefined ? {} : { error }) };
  return { text: `At most ${formatCount(triangles.max)}, so that the picture stays quick`, lift: { text: "Lift", edit } };
}
