/** Numbers as people type and paste them: grouped, with a decimal comma, in percent, thousands or a unit. Pure. */

/** What a field knows of its numbers. */
export interface NumberKind {
  readonly min?: number | undefined;
  readonly max?: number | undefined;
  /** There are no fractions: one separator before three digits groups them. */
  readonly isWhole?: boolean | undefined;
  /** The number that 100 % stands for; without it percent are refused. */
  readonly hundredPercent?: number | undefined;
  /** Words that may follow a number, with what one of them is in numbers of the field. */
  readonly units?: Readonly<Record<string, number>> | undefined;
}

/** The units of a field that has one, or none. */
export const unitsOf = (unit: string | null | undefined, size = 1): Record<string, number> => (unit === undefined || unit === null || unit === "" ? {} : { [unit]: size });

/** A number; two, if the text can be read as either; `undefined` if it is none, or not finished. */
export type TypedNumber = number | readonly [grouped: number, decimal: number] | undefined;

const THOUSANDS: Readonly<Record<string, number>> = { k: 1e3, K: 1e3, M: 1e6 };

/** Digits in groups of three, and what follows them. */
const GROUPED = /^([1-9]\d{0,2}(?:([ ',.])\d{3})(?:\2\d{3})*)(?:([.,])(\d*))?$/;
/** Digits with at most one decimal point or comma, and a power of ten. */
const PLAIN = /^(\d*)(?:([.,])(\d*))?(e[+-]?\d+)?$/i;

export function readTyped(text: string, kind: NumberKind = {}): TypedNumber {
  const [, sign = "", rest = ""] = /^[≈≥≤]?\s*([+-]?)(.*)$/s.exec(text.trim().replace("−", "-")) ?? [];
  const { digits, factor } = withoutSuffix(rest, kind);
  if (factor === undefined) return undefined;
  const readings = readDigits(digits, kind.isWhole === true).map((value) => (sign === "-" ? -value : value) * factor);
  const [first, second] = readings;
  if (first === undefined || !readings.every(Number.isFinite)) return undefined;
  if (second === undefined) return first;
  const { min = -Infinity, max = Infinity } = kind;
  const possible = readings.filter((value) => value >= min && value <= max);
  return possible.length === 1 ? possible[0] : [first, second];
}

/** The digits before a unit, `%`, `k` or `M`, and what these multiply them by. */
function withoutSuffix(text: string, { hundredPercent, units = {} }: NumberKind): { readonly digits: string; readonly factor: number | undefined } {
  const unit = Object.keys(units).find((word) => text.endsWith(word) && !/e$/i.test(word));
  if (unit !== undefined) return { digits: text.slice(0, -unit.length).trim(), factor: units[unit] };
  const [, digits = "", suffix = ""] = /^(.*?)\s*([%kKM]?)$/s.exec(text) ?? [];
  if (suffix === "%") return { digits, factor: hundredPercent === undefined ? undefined : hundredPercent / 100 };
  return { digits, factor: THOUSANDS[suffix] ?? 1 };
}

/** One reading, two, or none. */
function readDigits(text: string, isWhole: boolean): readonly number[] {
  const normal = text.replace(/\s/g, " ").replace(/[’_]/g, "'");
  const plain = plainNumber(normal);
  const grouped = groupedNumber(normal);
  if (grouped === undefined) return plain === undefined ? [] : [plain];
  if (plain === undefined || isWhole) return [grouped];
  // One separator before three digits. The page writes a decimal point, and never groups by it.
  return normal.includes(".") ? [plain] : [grouped, plain];
}

function plainNumber(text: string): number | undefined {
  const [, before, , after = "", power = ""] = PLAIN.exec(text) ?? [];
  if (before === undefined || before + after === "") return undefined;
  return Number(`${before || "0"}.${after || "0"}${power}`);
}

function groupedNumber(text: string): number | undefined {
  const [, groups, separator, decimal, after = ""] = GROUPED.exec(text) ?? [];
  if (groups === undefined || decimal === separator) return undefined;
  return Number(`${groups.replace(/[^\d]/g, "")}.${after || "0"}`);
}
