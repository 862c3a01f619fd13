/** What positions along the world's axes are, as a file says it, and round ticks in these: longitudes, depths. Pure. */

import { alongOf, indexAlong, type PlacedGrid } from "./places";
import { ticks, tickText } from "./ticks";

/** As a volume's description has it. */
export interface DescribedAxis {
  readonly name: string;
  readonly unit: string | null;
  readonly kind: string;
  /** Of each sample; `null`: the world's coordinates are the positions. */
  readonly positions: readonly number[] | null;
  /** Without `positions`: the position is the world's coordinate times −1. */
  readonly pointsDown: boolean;
}

export interface PlacedTick {
  /** The world's coordinate. */
  readonly at: number;
  readonly text: string;
}

/** Positions along one of the world's axes. */
export interface PhysicalAxis {
  /** What they are, with their unit. */
  readonly title: string;
  /** The position at a coordinate of the world, as a text; `undefined` outside of the samples. */
  readonly textAt: (coordinate: number) => string | undefined;
  /** Round positions between two coordinates. */
  readonly ticks: (low: number, high: number, max: number) => readonly PlacedTick[];
}

/** Steps of degrees, of which more than one go into a full turn. */
const DEGREES = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 60, 90] as const;
/** A direction this near to an axis of the world is along it. */
const ALONG = 0.9999;

/** Along x, y and z of the world: those whose positions are known. */
export function physicalAxes(grid: PlacedGrid, axes: readonly (DescribedAxis | null)[] | undefined): readonly (PhysicalAxis | undefined)[] {
  return [0, 1, 2].map((world) => {
    const axis = grid.direction.findIndex((direction) => Math.abs(direction[world] ?? 0) > ALONG);
    const described = axes?.[axis];
    return described === null || described === undefined ? undefined : physicalAxis(grid, axis, world, described);
  });
}

function physicalAxis(grid: PlacedGrid, axis: number, world: number, described: DescribedAxis): PhysicalAxis {
  const { positions, pointsDown } = described;
  const sign = Math.sign(grid.direction[axis]?.[world] ?? 1);
  const origin = grid.origin[world] ?? 0;
  const toPosition = (coordinate: number) => {
    if (positions === null) return pointsDown ? -coordinate : coordinate;
    return between(positions, indexAlong(grid, axis, sign * (coordinate - origin)));
  };
  const toWorld = (position: number) => {
    if (positions === null) return pointsDown ? -position : position;
    return origin + sign * alongOf(grid, axis, indexOf(positions, position));
  };
  const text = (value: number, step: number) => positionText(described, value, step);
  return {
    title: titleOf(described),
    textAt: (coordinate) => {
      const position = toPosition(coordinate);
      const [low, high] = ends(grid, axis, toPosition, sign, origin);
      return position >= Math.min(low, high) && position <= Math.max(low, high) ? text(position, Math.abs(high - low) / 1000) : undefined;
    },
    ticks: (low, high, max) => {
      const [from, to] = [toPosition(low), toPosition(high)].sort((a, b) => a - b) as [number, number];
      const values = isAngle(described) ? degrees(from, to, max) : ticks(from, to, max);
      const step = values.length > 1 ? (values[1] ?? 0) - (values[0] ?? 0) : to - from;
      return values.map((value) => ({ at: toWorld(value), text: text(value, step) }));
    },
  };
}

function ends(grid: PlacedGrid, axis: number, toPosition: (coordinate: number) => number, sign: number, origin: number): readonly [number, number] {
  const last = (grid.dims[axis] ?? 1) - 1;
  return [toPosition(origin), toPosition(origin + sign * alongOf(grid, axis, last))];
}

const isAngle = ({ kind }: DescribedAxis) => kind === "longitude" || kind === "latitude";

/** Multiples of the smallest step of degrees that gives at most `max`. */
function degrees(low: number, high: number, max: number): number[] {
  const step = DEGREES.find((step) => (high - low) / step <= max) ?? 90;
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1) }, (_, i) => (first + i) * step);
}

/** Positions ascend or descend. */
function between(positions: readonly number[], index: number): number {
  const low = Math.min(Math.max(0, Math.floor(index)), positions.length - 2);
  const [from, to] = [positions[low] ?? 0, positions[low + 1] ?? 0];
  return from + (index - low) * (to - from);
}

function indexOf(positions: readonly number[], position: number): number {
  const ascends = (positions.at(-1) ?? 0) > (positions[0] ?? 0);
  const beyond = positions.findIndex((other) => (ascends ? other > position : other < position));
  const low = Math.min(Math.max(0, (beyond < 0 ? positions.length : beyond) - 1), positions.length - 2);
  const [from, to] = [positions[low] ?? 0, positions[low + 1] ?? 0];
  return low + (to === from ? 0 : (position - from) / (to - from));
}

const KINDS: Readonly<Record<string, string>> = { longitude: "Longitude", latitude: "Latitude", depth: "Depth", height: "Height", pressure: "Pressure" };
const UNITS: Readonly<Record<string, string>> = { meters: "m", meter: "m", metres: "m", metre: "m", kilometers: "km", kilometres: "km" };

function unitOf({ unit }: DescribedAxis): string {
  return unit === null ? "" : (UNITS[unit.toLowerCase()] ?? unit);
}

function titleOf(described: DescribedAxis): string {
  const name = KINDS[described.kind] ?? described.name;
  const unit = unitOf(described);
  return isAngle(described) || unit === "" ? name : `${name} (${unit})`;
}

/** 150° W, 30° N, 500. */
function positionText(described: DescribedAxis, value: number, step: number): string {
  if (!isAngle(described)) return tickText(value, step);
  // Longitudes of a file may go on beyond half a turn.
  const turned = described.kind === "longitude" ? ((((value + 180) % 360) + 360) % 360) - 180 : value;
  const amount = tickText(Math.abs(turned), step);
  if (Number(amount) === 0 || (described.kind === "longitude" && Number(amount) === 180)) return `${amount}°`;
  const letters = described.kind === "longitude" ? ["E", "W"] : ["N", "S"];
  return `${amount}° ${letters[turned < 0 ? 1 : 0] ?? ""}`;
}
