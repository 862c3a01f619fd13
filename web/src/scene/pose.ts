/** The camera's pose, as a small plain object, and named directions. Pure. */

import type { AxisName } from "../world/axes";
import type { Vec3 } from "./world";

export type Projection = "perspective" | "orthographic";

/**
 * The camera's pose: JSON, so that it can stand in a link. The third axis of the world is up. An orthographic camera shows at the target
 * what a perspective one would, so that the distance is the zoom of both.
 */
export interface CameraPose {
  /** World units. */
  readonly position: Vec3;
  readonly target: Vec3;
  readonly projection: Projection;
}

/** A pose without a projection keeps the current one. */
export type PoseToRestore = Pick<CameraPose, "position" | "target"> & Partial<CameraPose>;

/** What a camera sees, apart from its picture's size: either `fov` or `height` is given. */
export interface Sight {
  readonly position: Vec3;
  readonly target: Vec3;
  /** Up in the picture, if that is not the third axis of the world. */
  readonly up?: Vec3;
  /** Vertical field of view, degrees. */
  readonly fov?: number;
  /** Height of an orthographic picture at the target, world units. */
  readonly height?: number;
}

/** Horizontal share of a direction below which it counts as vertical. */
const STEEP = 1e-3;

/**
 * @param fov vertical field of view, radians
 * @param away distance of the target in the world as it is shown
 */
export function sightOf({ position, target, projection }: CameraPose, fov: number, away: number): Sight {
  const [x, y, z] = [position[0] - target[0], position[1] - target[1], position[2] - target[2]];
  const level = Math.hypot(x, y);
  const isSteep = level < STEEP * Math.hypot(level, z);
  // Exactly above or below, pictures have the first axis at their top or bottom.
  const [across, along] = level === 0 ? [1, 0] : [x / level, y / level];
  const up: Vec3 = [-Math.sign(z) * across || 0, -Math.sign(z) * along || 0, 0];
  const lens = projection === "perspective" ? { fov: (fov * 180) / Math.PI } : { height: 2 * away * Math.tan(fov / 2) };
  return { position, target, ...(isSteep ? { up } : {}), ...lens };
}

/** Tilt from the vertical that just suffices for the other two axes to be level. */
const TILT = 1e-6;

const VIEWS: Readonly<Record<AxisName, Vec3>> = {
  "+x": [1, 0, 0],
  "-x": [-1, 0, 0],
  "+y": [0, 1, 0],
  "-y": [0, -1, 0],
  "+z": [0, 0, 1],
  "-z": [0, 0, -1],
};

/** The up vector in the view from an end of the third axis: of a patient the front, else the one that makes the first axis point to the right. */
export function upAlong(axis: "+z" | "-z", frame: string | undefined): Vec3 {
  if (frame === "LPS") return [0, -1, 0];
  return axis === "+z" || frame === "RAS" ? [0, 1, 0] : [0, -1, 0];
}

/** Unit vector (to within `TILT`) from the target to a camera at an end of an axis. */
export function axisView(axis: AxisName, frame: string | undefined): Vec3 {
  if (axis !== "+z" && axis !== "-z") return VIEWS[axis];
  const [z, up] = [VIEWS[axis][2], upAlong(axis, frame)[1]];
  return [0, -TILT * up * z, z];
}

/** Direction from which a page that was just opened shows the surface: from above and, of a patient, from the front and the left. */
export function homeDirection(frame: string | undefined): Vec3 {
  return frame === "LPS" ? [0.72, -0.58, 0.38] : [-0.72, 0.58, 0.38];
}

/** Whether something read from a link is a pose: finite numbers, and a direction to look in. */
export function isPose(value: unknown): value is CameraPose {
  if (typeof value !== "object" || value === null) return false;
  const { position, target, projection } = value as Partial<Record<keyof CameraPose, unknown>>;
  if (!isVector(position) || !isVector(target)) return false;
  const apart = Math.hypot(...position.map((p, axis) => p - (target[axis] ?? 0)));
  return apart > 0 && Number.isFinite(apart) && (projection === "perspective" || projection === "orthographic");
}

function isVector(value: unknown): value is Vec3 {
  return Array.isArray(value) && value.length === 3 && value.every((n) => typeof n === "number" && Number.isFinite(n));
}
