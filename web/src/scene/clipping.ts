/** Clip plane and clip box: planes for the shaders, and caps on the cuts through solids. */

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DoubleSide,
  EqualStencilFunc,
  Group,
  Matrix4,
  Mesh,
  PerspectiveCamera,
  Plane,
  Vector3,
  Vector4,
  type Box3,
  type OrthographicCamera,
} from "three";
import { cutFaces } from "./convex";
import { PlainMaterial } from "./plain";
import type { Vec3 } from "./world";

/** A clip plane and a clip box. World units. */
export interface Clip {
  /** Keeps the half space `normal · p ≤ offset`. The normal is a unit vector. */
  readonly plane?: { readonly normal: Vec3; readonly offset: number } | undefined;
  /** Keeps the inside. */
  readonly box?: { readonly min: Vec3; readonly max: Vec3 } | undefined;
  /** Closes solids at the cut; else their inside is seen. */
  readonly caps: boolean;
}

export const NO_CLIP: Clip = { caps: true };

/** Clip planes; the kept part is on their positive side. */
export function clipPlanes({ plane, box }: Clip): Plane[] {
  const planes: Plane[] = [];
  if (plane !== undefined) planes.push(new Plane(new Vector3(...plane.normal).negate(), plane.offset));
  if (box !== undefined) {
    for (const axis of [0, 1, 2] as const) {
      const normal = new Vector3().setComponent(axis, 1);
      planes.push(new Plane(normal, -box.min[axis]), new Plane(normal.clone().negate(), box.max[axis]));
    }
  }
  return planes;
}

/** Properties of a surface for its caps. */
export interface CappedSurface {
  readonly surface: number;
  readonly color: string;
}

/** A little darker than the surface, so that the cut is visible even if the light does not set it apart. */
function capColor(color: string): string {
  return `#${new Color(color).multiplyScalar(0.62).getHexString()}`;
}

export class Clipping {
  /** Caps, to be rendered with the surfaces. */
  readonly object = new Group();
  private clip = NO_CLIP;
  private planes: Plane[] = [];
  private geometry = new BufferGeometry();
  /** First vertex and number of vertices of each plane's cap. */
  private ranges: (readonly [number, number])[] = [];
  private readonly meshes = new Map<number, Mesh<BufferGeometry, PlainMaterial[]>>();

  get value(): Clip {
    return this.clip;
  }

  get count(): number {
    return this.planes.length;
  }

  /** Whether there are caps to draw. */
  get caps(): boolean {
    return this.clip.caps && this.geometry.hasAttribute("position");
  }

  /** `bounds`: of the volume, inside of which solids are closed. */
  set(clip: Clip, bounds: Box3): void {
    this.clip = clip;
    this.planes = clipPlanes(clip);
    this.geometry.dispose();
    this.geometry = new BufferGeometry();
    const corners: number[] = [];
    this.ranges = (bounds.isEmpty() ? [] : cutFaces(bounds, this.planes)).map((face) => {
      const start = corners.length / 3;
      for (let i = 1; i + 1 < face.length; i += 1) {
        for (const p of [face[0], face[i], face[i + 1]]) corners.push(...(p?.toArray() ?? []));
      }
      return [start, corners.length / 3 - start];
    });
    if (corners.length > 0) this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
    for (const mesh of this.meshes.values()) mesh.geometry = this.geometry;
  }

  /**
   * Shows caps of these surfaces, later ones over earlier ones. Only planes that face the camera have caps: a plane that is seen from
   * inside never cuts a solid open towards the eye.
   */
  showCaps(surfaces: readonly CappedSurface[], camera: PerspectiveCamera | OrthographicCamera): void {
    this.object.clear();
    this.geometry.clearGroups();
    this.ranges.forEach(([start, count], i) => {
      const plane = this.planes[i];
      if (count > 0 && plane !== undefined && facesCamera(plane, camera)) this.geometry.addGroup(start, count, 0);
    });
    surfaces.forEach(({ surface, color }, order) => {
      const mesh = this.meshes.get(surface) ?? this.makeMesh(surface, color);
      for (const material of mesh.material) material.style = capColor(color);
      // After the surfaces.
      mesh.renderOrder = 10 + order;
      this.object.add(mesh);
    });
  }

  hideCaps(): void {
    this.object.clear();
  }

  /**
   * The planes in the camera's space, for the shaders.
   * @param facing only those that the camera looks at; the others cut nothing, but keep their places
   */
  inView(camera: PerspectiveCamera | OrthographicCamera, facing = false): Vector4[] {
    const view = new Matrix4().copy(camera.matrixWorld).invert();
    return this.planes.map((plane) => {
      if (facing && !facesCamera(plane, camera)) return new Vector4(0, 0, 0, 1);
      const { normal, constant } = plane.clone().applyMatrix4(view);
      return new Vector4(...normal.toArray(), constant);
    });
  }

  private makeMesh(surface: number, color: string): Mesh<BufferGeometry, PlainMaterial[]> {
    const bit = 1 << surface;
    const stencil = { stencilWrite: true, stencilWriteMask: 0, stencilFunc: EqualStencilFunc, stencilRef: bit, stencilFuncMask: bit };
    const mesh = new Mesh(this.geometry, [Object.assign(new PlainMaterial(color), { side: DoubleSide, ...stencil })]);
    mesh.frustumCulled = false;
    this.meshes.set(surface, mesh);
    return mesh;
  }
}

/** Whether the camera looks at a plane from the side that is cut away. */
function facesCamera(plane: Plane, camera: PerspectiveCamera | OrthographicCamera): boolean {
  if (camera instanceof PerspectiveCamera) return plane.distanceToPoint(camera.position) < 0;
  // Not `getWorldDirection`, which would update the camera's matrices.
  return plane.normal.dot(new Vector3().setFromMatrixColumn(camera.matrixWorld, 2)) < 0;
}
