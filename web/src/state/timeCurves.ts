/** What was measured of a surface in every time step: area, volume, and the values at points. Pure. */

import type { Vec3, View, VolumeInfo } from "../protocol/types";
import { csvText } from "./csv";
import type { Enclosed } from "./enclosed";
import { lengthUnit, unitWord } from "./lengths";
import { digits } from "./numbers";

/** With more points the curves could not be told apart. */
export const MAX_CURVE_POINTS = 4;

export interface StepRow {
  readonly step: number;
  /** `undefined`: the step has no surface. */
  readonly sums: Enclosed | undefined;
  /** At each point; `undefined` outside of the volume, and if no value is known. */
  readonly values: readonly (number | undefined)[];
}

export interface TimeCurves {
  readonly volume: string;
  /** What the surface was made of: another one has other curves. */
  readonly of: View;
  readonly field: string;
  readonly count: number;
  readonly points: readonly Vec3[];
  /** In the order of the steps; of a measurement that was stopped the first ones. */
  readonly rows: readonly StepRow[];
  readonly isRunning: boolean;
}

/** One line over the steps. */
export interface Curve {
  readonly title: string;
  /** Of each row; `undefined` is a gap. */
  readonly values: readonly (number | undefined)[];
}

/** Those that have a value in some step. */
export function curvesOf({ field, points, rows }: TimeCurves, volume: VolumeInfo | undefined): readonly Curve[] {
  const unit = lengthUnit(volume);
  const fieldUnit = volume?.fields.find(({ name }) => name === field)?.unit;
  const ofPoints = points.map((_, i): Curve => ({
    title: `${field}${points.length > 1 ? ` at point ${i + 1}` : " at the point"}${fieldUnit ? `, in ${fieldUnit}` : ""}`,
    values: rows.map(({ values }) => values[i]),
  }));
  const all: readonly Curve[] = [
    { title: `Area, in ${unitWord(unit, 2)}`, values: rows.map(({ sums }) => sums?.area ?? 0) },
    { title: `Volume, in ${unitWord(unit, 3)}`, values: rows.map(({ sums }) => (sums === undefined ? 0 : sums.volume)) },
    ...ofPoints,
  ];
  return all.filter(({ values }) => values.some((value) => value !== undefined));
}

/** Positions of the rows' steps between the first step and the last one, 0 to 1: by time if times are known. */
export function placesOfSteps({ count, rows }: TimeCurves, times: VolumeInfo["times"] | undefined): readonly number[] {
  const time = (step: number) => times?.values?.[step] ?? step;
  const [first, last] = [time(0), time(count - 1)];
  const isKnown = Number.isFinite(first) && Number.isFinite(last) && last > first;
  return rows.map(({ step }) => (isKnown ? (time(step) - first) / (last - first) : step / Math.max(1, count - 1)));
}

/** A table for spreadsheets: a line for each step. @param label of a step, for people */
export function timeCurvesCsv(curves: TimeCurves, volume: VolumeInfo, label: (step: number) => string | undefined): string {
  const unit = lengthUnit(volume);
  const number = (value: number | undefined) => (value === undefined ? "" : digits(value));
  const names = curves.points.map((point, i) => `${curves.field} at point ${i + 1} (${point.map(digits).join(" ")})`);
  const head = ["volume", "step", "time", `area (${unitWord(unit, 2)})`, `volume (${unitWord(unit, 3)})`, "border edges", ...names];
  const rows = curves.rows.map(({ step, sums, values }) => [
    curves.volume,
    String(step + 1),
    label(step) ?? "",
    number(sums?.area ?? 0),
    number(sums === undefined ? 0 : sums.volume),
    String(sums?.borderEdges ?? 0),
    ...curves.points.map((_, i) => number(values[i])),
  ]);
  return csvText([head, ...rows]);
}
