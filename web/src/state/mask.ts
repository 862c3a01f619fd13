/** A mask as it is written: a field, how its values compare, and with what. Pure. */

import type { FieldInfo } from "../protocol/types";
import { hasLabels } from "./fields";
import { readTyped } from "./typedNumber";

/** How values compare, those that begin with others first; in words. */
export const COMPARISONS = [
  { symbol: "==", text: "is" },
  { symbol: "!=", text: "is not" },
  { symbol: ">=", text: "at least" },
  { symbol: "<=", text: "at most" },
  { symbol: ">", text: "above" },
  { symbol: "<", text: "below" },
] as const;

export type Comparison = (typeof COMPARISONS)[number]["symbol"];

/** Restricts a surface to samples at which the field's values satisfy a comparison. */
export interface Mask {
  readonly field: string;
  readonly comparison: Comparison;
  /** Numbers and ranges: `1,4..7`. One number unless the comparison is `==` or `!=`. */
  readonly values: string;
}

/** As edits have it: the first comparison is meant. */
export function readMask(text: string): Mask | undefined {
  const [, field, symbol, values] = /^(.*?)(==|!=|>=|<=|>|<)(.*)$/s.exec(text) ?? [];
  const comparison = COMPARISONS.find((known) => known.symbol === symbol)?.symbol;
  if (field === undefined || comparison === undefined || values === undefined) return undefined;
  return { field: unquoted(field.trim()), comparison, values: values.trim() };
}

/** A name in quotation marks, as expressions have it. */
const unquoted = (name: string) => /^(["`])(.+)\1$/s.exec(name)?.[2] ?? name;

export const maskText = ({ field, comparison, values }: Mask): string => `${field}${comparison}${values}`;

/** Several values are one or another, or none of them. */
export const takesList = (comparison: Comparison): boolean => comparison === "==" || comparison === "!=";

const NUMBER = String.raw`[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?`;
const RANGE = new RegExp(String.raw`^\s*(${NUMBER})\s*(?:\.\.\s*(${NUMBER})\s*)?$`, "i");
const MAX_RANGES = 64;

/** One number as the server reads it; the text itself if it is none. */
export function plainValue(text: string): string {
  const typed = readTyped(text);
  return typeof typed === "number" ? String(typed) : text.trim();
}

/** What is wrong with values, for the user; `undefined` if nothing is. */
export function refusedValues(comparison: Comparison, values: string): string | undefined {
  if (!takesList(comparison) && typeof readTyped(values) === "object") return `“${values.trim()}” can be read in two ways: write it without a comma`;
  const items = (takesList(comparison) ? values : plainValue(values)).split(",");
  const ranges = items.map((item) => RANGE.exec(item));
  const wrong = items.find((_, i) => ranges[i] === null);
  if (!takesList(comparison)) return items.length === 1 && wrong === undefined && ranges[0]?.[2] === undefined ? undefined : `“${values.trim()}” is not one number`;
  if (wrong !== undefined) return `“${wrong.trim()}” is neither a number nor a range such as 4..7`;
  const turned = ranges.find((range) => range?.[2] !== undefined && Number(range[1]) > Number(range[2]));
  if (turned !== undefined) return `“${turned?.[0].trim() ?? ""}” begins above its end`;
  return items.length > MAX_RANGES ? `${items.length} values, ${MAX_RANGES} is the maximum` : undefined;
}

/** What a mask begins with is known from: its type and values, and names of labels. */
type Field = Pick<FieldInfo, "range" | "labels" | "openingIso">;

/** What a field is compared with first: labels with all but the background, which is the lowest, other values with the middle of their range. */
export function firstMask(name: string, field: Field): Mask {
  const [low, high] = field.range;
  if (!hasLabels(field)) return { field: name, comparison: ">=", values: String(Number(((low + high) / 2).toPrecision(3))) };
  const first = low < high ? low + 1 : low;
  return { field: name, comparison: "==", values: first < high ? `${first}..${high}` : String(high) };
}

/** Whether a list of numbers and ranges has a number. */
export function listHas(values: string, value: number): boolean {
  return values.split(",").some((item) => {
    const [, from, to] = RANGE.exec(item) ?? [];
    return from !== undefined && value >= Number(from) && value <= Number(to ?? from);
  });
}

/** The list with a label or without, of the labels that there are: those that follow each other become a range. */
export function toggled(values: string, value: number, labels: readonly number[]): string {
  const chosen = labels.filter((label) => (label === value ? !listHas(values, label) : listHas(values, label)));
  const runs: [number, number][] = [];
  for (const label of chosen) {
    const last = runs.at(-1);
    if (last !== undefined && label === last[1] + 1) last[1] = label;
    else runs.push([label, label]);
  }
  return runs.map(([from, to]) => (from === to ? String(from) : `${from}..${to}`)).join(",");
}
