/** Area and enclosed volume in words. Pure. */

import type { Enclosed } from "../../state/enclosed";
import { unitWord } from "../../state/lengths";
import { formatCount, formatValue } from "../format";
import type { Row } from "./rows";

/** Four digits; large numbers in groups. */
function amount(value: number): string {
  return value < 1000 ? formatValue(value, 4) : formatCount(Number(value.toPrecision(4)));
}

/** `4,310 mm³`. @param unit of lengths, if it is known */
export const amountText = (value: number, unit: string | undefined, power: 2 | 3) => `${amount(value)} ${unitWord(unit, power)}`;

/** @param unit of lengths, if it is known */
export function enclosedRows({ area, volume }: Enclosed, unit: string | undefined): readonly Row[] {
  const size = volume === undefined ? "none, it is open" : amountText(Math.abs(volume), unit, 3);
  return [
    ["Area", amountText(area, unit, 2)],
    [volume !== undefined && volume < 0 ? "Enclosed, of lower values" : "Enclosed volume", size],
  ];
}

/** What the numbers are of. @param error how far the mesh is off, in words */
export function enclosedNote({ borderEdges }: Enclosed, error: string | undefined): string {
  const of = `Of the mesh on screen, with what is clipped or peeled away${error === undefined ? "" : `; ${error}`}.`;
  if (borderEdges === 0) return of;
  return `The surface ends at ${formatCount(borderEdges)} ${borderEdges === 1 ? "edge" : "edges"}: at the volume's faces, at missing samples, or at cracks. ${of}`;
}
