/** Where index space lies in the world, and how far away a camera has to stand. Pure. */

import { Box3, Matrix3, Matrix4, Vector3 } from "three";

export type Triple = readonly [number, number, number];

/** `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`. */
export interface Grid {
  readonly origin: Triple;
  readonly spacing: Triple;
  /** Unit vectors of the axes in the world. */
  readonly direction: readonly [Triple, Triple, Triple];
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

/** Turns what lies along the grid's axes in world lengths, as normals do. */
export function worldFromGrid({ direction: [x, y, z] }: Grid): Matrix3 {
  return new Matrix3().set(x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]);
}

/**
 * Distance from the box's centre at which a camera that looks against `back` has all of the box in view.
 * @param back unit vector from the centre to the camera
 * @param up any vector not along `back`
 * @param fovY vertical field of view, radians
 * @param aspect width over height
 */
export function fitDistance(box: Box3, back: Vector3, up: Vector3, fovY: number, aspect: number): number {
  const center = box.getCenter(new Vector3());
  const right = new Vector3().crossVectors(up, back).normalize();
  const top = new Vector3().crossVectors(back, right);
  const tanY = Math.tan(fovY / 2);
  const tanX = tanY * aspect;
  let distance = 0;
  for (let corner = 0; corner < 8; corner += 1) {
    const p = new Vector3(
      corner & 1 ? box.max.x : box.min.x,
      corner & 2 ? box.max.y : box.min.y,
      corner & 4 ? box.max.z : box.min.z,
    ).sub(center);
    const reach = Math.max(Math.abs(p.dot(right)) / tanX, Math.abs(p.dot(top)) / tanY);
    distance = Math.max(distance, reach + p.dot(back));
  }
  return distance;
}
