/** Transforms from index space to the world, and the distance of a camera. Pure. */

import { Matrix3, Matrix4, Vector3 } from "three";

export type Vec3 = readonly [number, number, number];

/** `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`, of an uneven axis with its even coordinate in place of the index. */
export interface Grid {
  readonly origin: Vec3;
  readonly spacing: Vec3;
  /** Unit vectors of the axes in the world. */
  readonly direction: readonly [Vec3, Vec3, Vec3];
  /** Samples along each axis; needed for what is placed by the volume's faces. */
  readonly dims?: Vec3;
  /** Along the axes that are not even, of each sample, in world units from the first one. */
  readonly positions?: readonly (readonly number[] | null)[];
  /** What the world's axes are: `LPS`, `RAS`, or another name if that is unknown. */
  readonly frame?: string;
}

export function worldFromIndex({ origin, spacing, direction: [x, y, z] }: Grid): Matrix4 {
  const [sx, sy, sz] = spacing;
  // prettier-ignore
  return new Matrix4().set(
    x[0] * sx, y[0] * sy, z[0] * sz, origin[0],
    x[1] * sx, y[1] * sy, z[1] * sz, origin[1],
    x[2] * sx, y[2] * sy, z[2] * sz, origin[2],
    0, 0, 0, 1,
  );
}

/** Rotates vectors along the grid's axes in world lengths, such as normals. */
export function worldFromGrid({ direction: [x, y, z] }: Grid): Matrix3 {
  return new Matrix3().set(x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]);
}

/** The corners of a box in index space, in the world. */
export function corners(box: { readonly min: Vec3; readonly max: Vec3 }, world: Matrix4): Vector3[] {
  return Array.from({ length: 8 }, (_, corner) =>
    new Vector3(
      (corner & 1 ? box.max : box.min)[0],
      (corner & 2 ? box.max : box.min)[1],
      (corner & 4 ? box.max : box.min)[2],
    ).applyMatrix4(world),
  );
}

/**
 * Distance from `center` at which a camera that looks against `back` has all points in view.
 * @param back unit vector from the centre to the camera
 * @param up any vector not along `back`
 * @param fovY vertical field of view, radians
 * @param aspect width over height
 */
export function fitDistance(
  points: readonly Vector3[],
  center: Vector3,
  back: Vector3,
  up: Vector3,
  fovY: number,
  aspect: number,
): number {
  const right = new Vector3().crossVectors(up, back).normalize();
  const top = new Vector3().crossVectors(back, right);
  const tanY = Math.tan(fovY / 2);
  const tanX = tanY * aspect;
  const p = new Vector3();
  let distance = 0;
  for (const point of points) {
    p.subVectors(point, center);
    const reach = Math.max(Math.abs(p.dot(right)) / tanX, Math.abs(p.dot(top)) / tanY);
    distance = Math.max(distance, reach + p.dot(back));
  }
  return distance;
}

/** The vertical field of view in which the smaller one, of width and height, is `fov`. Radians. @param aspect width over height */
export function verticalFov(fov: number, aspect: number): number {
  return 2 * Math.atan(Math.tan(fov / 2) / Math.min(1, aspect));
}
