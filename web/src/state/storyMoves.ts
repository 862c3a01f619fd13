/** Playback of a story: duration of a sentence and movement of the camera. Pure. */

import type { Vec3 } from "../protocol/types";
import type { Pose } from "./look";
import { lengthOf, minus } from "./vectors";

/** Seconds in which a sentence is read: some three words in a second. */
export function readingSeconds(text: string): number {
  const words = text.split(/\s+/).filter(Boolean).length;
  return Math.min(12, Math.max(2.5, 1 + words / 3));
}

const mix = (a: number, b: number, t: number) => a + (b - a) * t;
const mixed = (a: Vec3, b: Vec3, t: number): Vec3 => [mix(a[0], b[0], t), mix(a[1], b[1], t), mix(a[2], b[2], t)];

/** Between two poses: the camera turns around what it looks at, and begins and ends slowly. @param t 0 to 1 */
export function poseBetween(from: Pose, to: Pose, t: number): Pose {
  const eased = t * t * (3 - 2 * t);
  const target = mixed(from.target, to.target, eased);
  const [a, b] = [minus(from.position, from.target), minus(to.position, to.target)];
  const [la, lb] = [lengthOf(a), lengthOf(b)];
  if (!(la > 0) || !(lb > 0)) return t < 1 ? from : to;
  // By equal factors in equal times.
  const distance = la * (lb / la) ** eased;
  const [from2, to2] = [angles(a), angles(b)];
  const turn = ((((to2.around - from2.around + Math.PI) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI)) - Math.PI;
  const [around, up] = [from2.around + turn * eased, mix(from2.up, to2.up, eased)];
  const flat = distance * Math.cos(up);
  return { target, position: [target[0] + flat * Math.cos(around), target[1] + flat * Math.sin(around), target[2] + distance * Math.sin(up)] };
}

function angles(v: Vec3): { readonly around: number; readonly up: number } {
  return { around: Math.atan2(v[1], v[0]), up: Math.atan2(v[2], Math.hypot(v[0], v[1])) };
}
