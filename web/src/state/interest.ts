/** Regions of interest that are painted on the surface: spheres of which near ones become one. Pure. */

import type { Vec3, View } from "../protocol/types";
import { lengthOf, minus } from "./vectors";

export type Interest = View["interest"];
type Region = Interest[number];
type Ball = NonNullable<Region["sphere"]>;

/** As many as the server takes. */
export const MAX_REGIONS = 64;
/** Of a painted region: almost nothing is merged there. */
const IMPORTANCE = 0.95;
/** Two balls are merged if the ball around both has at most this many times the volume of the two. */
const GROWS_BY = 1.3;

const distance = (a: Vec3, b: Vec3) => lengthOf(minus(a, b));

/** The smallest ball around two. */
function around(a: Ball, b: Ball): Ball {
  const apart = distance(a.center, b.center);
  if (apart + b.radius <= a.radius) return a;
  if (apart + a.radius <= b.radius) return b;
  const radius = (apart + a.radius + b.radius) / 2;
  const t = (radius - a.radius) / apart;
  const center = [0, 1, 2].map((axis) => (a.center[axis] ?? 0) + t * ((b.center[axis] ?? 0) - (a.center[axis] ?? 0)));
  return { center: center as unknown as Vec3, radius };
}

/**
 * Adds a ball. It is merged with each ball of the same importance near it; if that leaves more than 64, the list stays as it is.
 */
export function paint(regions: Interest, center: Vec3, radius: number): Interest {
  let ball: Ball = { center, radius };
  let rest = regions;
  for (;;) {
    const near = rest.findIndex(({ sphere, importance }) => {
      if (sphere === undefined || importance !== IMPORTANCE) return false;
      return around(sphere, ball).radius ** 3 <= GROWS_BY * (sphere.radius ** 3 + ball.radius ** 3);
    });
    const sphere = rest[near]?.sphere;
    if (sphere === undefined) break;
    ball = around(sphere, ball);
    rest = rest.toSpliced(near, 1);
  }
  if (rest.length >= MAX_REGIONS) return regions;
  return [...rest, { sphere: ball, importance: IMPORTANCE }];
}
