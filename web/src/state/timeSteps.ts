/** Time steps of the open volume: how many there are, and how each is called. Pure. */

import type { ViewerState } from "./viewer";

type Known = Pick<ViewerState, "volume" | "volumes" | "stepLabel" | "target">;

/** Steps may have appeared since the volume was opened: then the list of volumes has more. */
export function stepCount({ volume, volumes }: Known): number {
  const listed = volumes?.find(({ id }) => id === volume?.id)?.steps ?? 1;
  return Math.max(volume?.steps ?? 1, listed);
}

/** A step for people: `1850-01-16`, `12.5 s`; `undefined` if the server has not said it. */
export function stepLabel({ volume, stepLabel: shown, target }: Known, step: number): string | undefined {
  const { times } = volume ?? {};
  const listed = times?.labels?.[step];
  if (listed !== undefined) return listed;
  if (step === target?.step && shown !== undefined) return shown;
  return step === volume?.step ? times?.label : undefined;
}

/** A step with its place among all. */
export function stepWords(known: Known, step: number): string {
  const label = stepLabel(known, step);
  return `${label === undefined ? "" : `${label}, `}${step + 1} of ${stepCount(known)}`;
}

/** The step that a player shows next; `undefined` at the end. */
export function nextStep(step: number, count: number, loop: boolean): number | undefined {
  if (step + 1 < count) return step + 1;
  return loop && count > 1 ? 0 : undefined;
}
