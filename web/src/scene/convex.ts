/** A box cut by planes: the polygons of the cuts. Pure. */

import { Plane, Vector3, type Box3 } from "three";

type Polygon = readonly Vector3[];

/** Faces of a box as polygons, each with its corners in order. */
function boxFaces({ min, max }: Box3): Polygon[] {
  const corner = (i: number) => new Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z);
  const faces = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];
  return faces.map((face) => face.map(corner));
}

/** The part of a polygon on the plane's positive side. */
function cutPolygon(polygon: Polygon, plane: Plane): Vector3[] {
  const kept: Vector3[] = [];
  polygon.forEach((point, i) => {
    const next = polygon[(i + 1) % polygon.length] ?? point;
    const [a, b] = [plane.distanceToPoint(point), plane.distanceToPoint(next)];
    if (a >= 0) kept.push(point.clone());
    if (a >= 0 !== b >= 0) kept.push(point.clone().lerp(next, a / (a - b)));
  });
  return kept;
}

/** Points on a plane in the order in which they go around their middle, each once. */
function around(all: readonly Vector3[], normal: Vector3, tolerance: number): Vector3[] {
  const points = all.filter((p, i) => all.findIndex((q) => q.distanceTo(p) < tolerance) === i);
  const middle = points.reduce((sum, p) => sum.add(p), new Vector3()).divideScalar(points.length);
  const u = new Vector3().crossVectors(normal, Math.abs(normal.x) < 0.7 ? new Vector3(1, 0, 0) : new Vector3(0, 1, 0)).normalize();
  const v = new Vector3().crossVectors(normal, u);
  const angle = (p: Vector3) => Math.atan2(p.clone().sub(middle).dot(v), p.clone().sub(middle).dot(u));
  return [...points].sort((a, b) => angle(a) - angle(b));
}

/**
 * Cuts of the planes through the part of the box on the positive side of all of them: a convex polygon for each plane, empty if it does not
 * cut.
 */
export function cutFaces(box: Box3, planes: readonly Plane[]): Vector3[][] {
  const tolerance = 1e-9 * box.getSize(new Vector3()).length();
  let faces: Polygon[] = boxFaces(box);
  let cuts: Vector3[][] = [];
  for (const plane of planes) {
    const cut = faces.map((face) => cutPolygon(face, plane)).filter((face) => face.length > 2);
    cuts = cuts.map((face) => cutPolygon(face, plane));
    const boundary = cut.flat().filter((p) => Math.abs(plane.distanceToPoint(p)) < tolerance);
    const face = isCut(faces, plane, tolerance) ? around(boundary, plane.normal, tolerance) : [];
    cuts.push(face);
    faces = face.length > 2 ? [...cut, face] : cut;
  }
  return cuts.map((face) => (face.length > 2 ? face : []));
}

/** Whether the plane has corners on both sides. */
function isCut(faces: readonly Polygon[], plane: Plane, tolerance: number): boolean {
  const distances = faces.flat().map((p) => plane.distanceToPoint(p));
  return distances.some((d) => d > tolerance) && distances.some((d) => d < -tolerance);
}
