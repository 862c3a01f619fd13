/** What is measured on the surface: distances, angles, readings of the fields at a place; and places with a name. Pure. */

import type { Vec3, VolumeInfo } from "../protocol/types";
import { csvText } from "./csv";
import { lengthUnit, unitWord } from "./lengths";
import { LinkError, toNumber, toNumbers } from "./linkReader";
import { digits, list } from "./numbers";
import { dot, lengthOf, minus } from "./vectors";

/** World units. */
export type Measure =
  | { readonly kind: "distance"; readonly points: readonly [Vec3, Vec3] }
  /** At the second point. */
  | { readonly kind: "angle"; readonly points: readonly [Vec3, Vec3, Vec3] }
  /** Values of the volume's fields, in their order, as they were read; `null` if there is none. */
  | { readonly kind: "reading"; readonly points: readonly [Vec3]; readonly values: readonly (number | null)[] }
  | { readonly kind: "label"; readonly points: readonly [Vec3]; readonly text: string };

export type MeasureKind = Measure["kind"];

/** More would hide the surface, and make links longer than programs take. */
export const MAX_MEASURES = 32;
/** Points that are picked for each. */
export const POINTS: Readonly<Record<MeasureKind, number>> = { distance: 2, angle: 3, reading: 1, label: 1 };
/** Of the name of a place. */
export const MAX_LABEL = 80;

/** As many digits as the scene's single precision has: more would only lengthen links. */
export function shortened(position: Vec3): Vec3 {
  return position.map((n) => Number(n.toPrecision(6))) as unknown as Vec3;
}

/** A distance or an angle of its points; `undefined` while there are too few. */
export function measureOf(kind: "distance" | "angle", [a, b, c]: readonly Vec3[]): Measure | undefined {
  if (a === undefined || b === undefined) return undefined;
  if (kind === "distance") return { kind, points: [a, b] };
  return c && { kind, points: [a, b, c] };
}

/** World units, or degrees; NaN for a reading or a label, and for an angle without two sides. */
export function amountOf(measure: Measure): number {
  switch (measure.kind) {
    case "distance":
      return lengthOf(minus(...measure.points));
    case "angle": {
      const [a, corner, b] = measure.points;
      const [u, v] = [minus(a, corner), minus(b, corner)];
      // By both sine and cosine: small angles keep their digits.
      const cross: Vec3 = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      if (dot(u, u) === 0 || dot(v, v) === 0) return NaN;
      return (180 / Math.PI) * Math.atan2(Math.hypot(...cross), dot(u, v));
    }
    case "reading":
    case "label":
      return NaN;
  }
}

/** Kinds in a link. */
const LETTERS = { distance: "d", angle: "a", reading: "r", label: "l" } as const;

export function measureText(measure: Measure): string {
  const numbers = list(measure.points.flat());
  const values = measure.kind === "reading" ? measure.values.map((value) => `,${value === null ? "" : digits(value)}`).join("") : "";
  // Without what parts measurements.
  const text = measure.kind === "label" ? `,${encodeURIComponent(measure.text)}` : "";
  return `${LETTERS[measure.kind]},${numbers}${values}${text}`;
}

/** @throws LinkError naming what was wrong */
export function readMeasure(text: string): Measure {
  const [letter, ...rest] = text.split(",");
  const kind = (Object.keys(LETTERS) as MeasureKind[]).find((name) => LETTERS[name] === letter);
  if (kind === undefined) throw new LinkError(`This link's “measure” begins with ${JSON.stringify(letter)}, expected d, a, r or l`);
  const count = 3 * POINTS[kind];
  const numbers = toNumbers("measure", rest.slice(0, kind === "reading" || kind === "label" ? count : undefined).join(), [count]);
  const points = Array.from({ length: POINTS[kind] }, (_, i) => numbers.slice(3 * i, 3 * i + 3) as unknown as Vec3);
  const [at = [0, 0, 0] as const] = points;
  if (kind === "label") return { kind, points: [at], text: labelOf(rest[count] ?? "") };
  if (kind !== "reading") return { kind, points } as unknown as Measure;
  return { kind, points: [at], values: rest.slice(count).map((value) => (value === "" ? null : toNumber("measure", value))) };
}

function labelOf(text: string): string {
  try {
    return decodeURIComponent(text).slice(0, MAX_LABEL);
  } catch {
    throw new LinkError(`This link's “measure” has the label ${JSON.stringify(text.slice(0, 40))}, which was cut off or changed`);
  }
}

/** A table for spreadsheets: a line for each, with its points and what was read there. */
export function measuresCsv(measures: readonly Measure[], volume: Pick<VolumeInfo, "fields" | "geometry" | "id">): string {
  const { id, fields } = volume;
  const coordinates = [1, 2, 3].flatMap((point) => [`x${point}`, `y${point}`, `z${point}`]);
  const names = fields.map(({ name, unit }) => (unit === null || unit === "" ? name : `${name} (${unit})`));
  const rows = measures.map((measure, i) => {
    const amount = amountOf(measure);
    const unit = { distance: unitWord(lengthUnit(volume)), angle: "degrees", reading: "", label: "" }[measure.kind];
    const points = measure.points.flat().map(digits);
    const values = measure.kind === "reading" ? measure.values.map((value) => (value === null ? "" : digits(value))) : [];
    return [id, String(i + 1), measure.kind, measure.kind === "label" ? measure.text : Number.isNaN(amount) ? "" : digits(amount), unit, ...points, ...new Array<string>(9 - points.length).fill(""), ...fields.map((_, field) => values[field] ?? "")];
  });
  return csvText([["volume", "number", "kind", "amount", "unit", ...coordinates, ...names], ...rows]);
}
