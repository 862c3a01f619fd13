/** A mask as it is written: a field, how its values compare, and with what. Pure. */

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

/** Where a surface may be: at samples where the field's values are so. */
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
  return { field: field.trim(), comparison, values: values.trim() };
}

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

/** What is wrong with values, for the user; `undefined` where nothing is. */
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

/** Values that whole numbers have if they are labels. */
const MAX_LABELS = 64;

interface Field {
  readonly type: string;
  readonly range: readonly [number, number];
  readonly histogram: { readonly counts: readonly number[] };
}

/** What a field is compared with first: labels with 1, other values with the middle of their range. */
export function firstMask(name: string, { type, range, histogram }: Field): Mask {
  const [low, high] = range;
  const isLabels = type !== "f32" && low === 0 && histogram.counts.filter((n) => n > 0).length <= MAX_LABELS;
  if (isLabels) return { field: name, comparison: "==", values: String(Math.min(1, high)) };
  return { field: name, comparison: ">=", values: String(Number(((low + high) / 2).toPrecision(3))) };
}
