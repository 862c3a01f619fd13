/** Numbers as text for the user, and back. Pure. */

import type { LengthScale } from "../state/lengths";

const grouped = new Intl.NumberFormat("en", { useGrouping: true, maximumFractionDigits: 0 });

/** 1,234,567 */
export function formatCount(n: number): string {
  return grouped.format(n);
}

/** 3.4 MB, in powers of 1000. */
export function formatBytes(bytes: number): string {
  if (bytes < 1000) return `${bytes} B`;
  const units = ["kB", "MB", "GB", "TB"];
  let value = bytes;
  let unit = "B";
  for (const next of units) {
    if (value < 999.5) break;
    value /= 1000;
    unit = next;
  }
  return `${value < 9.95 ? value.toFixed(1) : value.toFixed(0)} ${unit}`;
}

/** 85 ms, 2.31 s */
export function formatMs(ms: number): string {
  return ms < 1000 ? `${Math.round(ms)} ms` : `${(ms / 1000).toFixed(2)} s`;
}

/** Characters up to which a number is written without a power of ten. */
const MAX_PLAIN = 8;

/**
 * A value as short as four or five digits allow, whole numbers in full: what a number field shows. With a power of ten, `3.9e-5`, if that
 * is shorter than a row of zeros.
 */
export function formatValue(value: number, digits = 5): string {
  if (!Number.isFinite(value)) return "";
  // Whole numbers in full: a budget that is rounded up would look broken.
  if (Number.isInteger(value) && Math.abs(value) < 1e9) return String(value);
  const rounded = Number(value.toPrecision(digits));
  const [plain, power] = [String(rounded), rounded.toExponential().replace("e+", "e")];
  return plain.length <= MAX_PLAIN || plain.length <= power.length ? plain : power;
}

/** Digits that tell a thousand values between two others apart: more than four if these differ by little, as pressures in Pa do. */
export function digitsBetween(low: number, high: number): number {
  const size = Math.max(Math.abs(low), Math.abs(high));
  // A 32-bit float has no more than nine.
  return high > low ? Math.min(9, Math.max(4, Math.ceil(Math.log10(size / (high - low))) + 3)) : 4;
}

/**
 * `0.11 mm` if the unit is known, else `0.11 voxels`, in multiples of the volume's smallest distance between samples, which are true
 * whatever the unit of the world is.
 */
export function formatLength(length: number, { spacing, unit }: LengthScale, digits = 2): string {
  if (unit !== undefined) return `${formatValue(length, digits)} ${unit}`;
  const voxels = formatValue(length / spacing, digits);
  return `${voxels} ${voxels === "1" ? "voxel" : "voxels"}`;
}

/** 34 %; 100 % only if nothing is missing. */
export function formatPercent(share: number): string {
  return `${Math.floor(100 * share)} %`;
}

/** 19 %, 2.4 %, 0.08 %: two digits, whole numbers from 10 on; 100 % only if nothing is missing. */
export function formatShare(share: number): string {
  const percent = 100 * share;
  if (percent >= 10) return `${percent >= 100 ? 100 : Math.min(99, Math.round(percent))} %`;
  return `${Number(percent.toPrecision(2))} %`;
}
