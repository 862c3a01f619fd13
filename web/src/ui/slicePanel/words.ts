/** What is said of slices. Pure. */

import type { FieldInfo } from "../../protocol/types";
import type { Slicing } from "../../state/slicing";
import type { ConnectionState } from "../../net/connection";
import { worldOf, type PlacedGrid, type Triple } from "../../world/places";
import { formatValue } from "../format";

/** Decimals that tell positions of neighbouring samples apart. */
function decimalsOf({ spacing }: PlacedGrid): number {
  return Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(Math.min(...spacing)) + 1e-9)));
}

/** `−12.0, 34.5, 5.0 mm` */
export function positionWords(grid: PlacedGrid, index: Triple, unit: string | undefined): string {
  const decimals = decimalsOf(grid);
  const number = (n: number) => n.toFixed(decimals).replace(/^-(?=0\.?0*$)/, "").replace("-", "−");
  return `${worldOf(grid, index).map(number).join(", ")} ${unit ?? ""}`.trim();
}

/** As few digits as tell a 32-bit float from all others. */
function exact(value: number): string {
  const digits = [6, 7, 8].find((count) => Math.fround(Number(value.toPrecision(count))) === Math.fround(value)) ?? 9;
  return formatValue(value, digits);
}

/** The value of a sample in full, with its unit or the name of its label. */
export function valueWords(value: number, field: FieldInfo | undefined): string {
  if (Number.isNaN(value)) return "no value";
  const label = field?.labels?.find((one) => one.value === value);
  const text = exact(value);
  if (label !== undefined) return [label.stored ?? text, label.name].filter(Boolean).join(" · ");
  return `${text} ${field?.unit ?? ""}`.trim();
}

/** Why the slices are not those that were requested; empty if there is nothing to say. */
export function problemWords(problems: readonly (string | undefined)[], isAllCurrent: boolean, connection: ConnectionState, hasSome: boolean): string {
  const before = hasSome ? ". What is marked as old is from before" : "";
  const problem = problems.find((one) => one !== undefined);
  if (isAllCurrent) return "";
  if (connection !== "connected") return `No connection to the server: there are no new slices${before}`;
  return problem === undefined ? "" : `The slices cannot be shown: ${problem}${before}`;
}

/** Sides of a slice on which a patient's left may be shown. */
export const SIDES: readonly { readonly value: string; readonly text: string; readonly hint: string }[] = [
  { value: "right", text: "on the right", hint: "As radiologists have it: seen from the patient's feet, and from the front" },
  { value: "left", text: "on the left", hint: "As neurologists have it: seen from above, and from behind" },
];

export const LAYOUT_OPTIONS: readonly { readonly value: Slicing["layout"]; readonly text: string; readonly hint: string }[] = [
  { value: "picture", text: "Picture", hint: "The surface alone" },
  { value: "both", text: "Both", hint: "Three slices beside the surface" },
  { value: "slices", text: "Slices", hint: "Three slices, the surface hidden" },
];
