/** The camera: turned, moved and zoomed by the user within bounds, fitted to the surface; perspective or orthographic. */

import CameraControls from "camera-controls";
import {
  Box3,
  Matrix4,
  OrthographicCamera,
  PerspectiveCamera,
  Quaternion,
  Raycaster,
  Sphere,
  Spherical,
  Vector2,
  Vector3,
  Vector4,
} from "three";
import { homeDirection, sightOf, type CameraPose, type PoseToRestore, type Projection, type Sight } from "./pose";
import { Stretch } from "./stretch";
import { fitDistance, verticalFov, type Vec3 } from "./world";
import { focused, ZoomGestures, zoomed, type PickPoint, type PlaceInPicture, type Viewpoint, type Zooming } from "./zoom";

// Only what the controls use, so that the rest of three.js can be left out.
CameraControls.install({ THREE: { Box3, Matrix4, Quaternion, Raycaster, Sphere, Spherical, Vector2, Vector3, Vector4 } });

const FOV_DEGREES = 32;
const FOV = (FOV_DEGREES * Math.PI) / 180;
/** Empty border around a fitted surface, as a factor on the distance. */
const FIT_MARGIN = 1.04;
/** Bounds of the distance to the target, in radii of what is shown: the nearest shows some cells, the farthest a small surface. */
const NEAREST = 0.02;
const FARTHEST = 12;
/** Seconds in which a move is almost complete. */
const MOVE_SECONDS = 0.22;
const DRAG_SECONDS = 0.09;
/** A frame that took longer advances moves by this much, so that a slow renderer still shows some steps of them. */
const MAX_STEP_SECONDS = 0.1;
/** Amounts by which a key turns (radians), zooms and moves (shares of the distance). */
const KEY_TURN = Math.PI / 18;
const KEY_ZOOM = 0.16;
const KEY_MOVE = 0.06;

const reducedMotion = window.matchMedia("(prefers-reduced-motion: reduce)");

export class SceneCamera implements Zooming {
  /** Cameras with which the picture is rendered. */
  private readonly perspective = new PerspectiveCamera(FOV_DEGREES, 1, 0.1, 10);
  private readonly orthographic = new OrthographicCamera();
  /** Camera that the user moves, in units of the radius of the shown surfaces, because the controls' thresholds are absolute. */
  private readonly handled = new PerspectiveCamera(FOV_DEGREES, 1, 0.001, 1000);
  private readonly controls: CameraControls;
  /** Around the surfaces, and around all that is drawn. */
  private readonly sphere = new Sphere(new Vector3(), 1);
  private readonly drawn = new Sphere(new Vector3(), 1);
  private around = new Box3();
  private box = new Box3();
  private projectionInUse: Projection = "perspective";
  private stretch = new Stretch(1);
  /** World units in one unit of the controls. */
  private unit = 1;
  /** Vertical field of view, radians. */
  private fov = FOV;
  private moving = false;
  private lastAdvance = 0;
  private readonly gestures: ZoomGestures;

  /**
   * @param pick the place of a surface under the pointer
   * @param onChange the camera moves: `advance` has to be called in the next frame
   * Keys of the canvas, while it has the focus, are the alternative to each drag: arrows turn, shift and arrows move, + and − zoom.
   */
  constructor(
    canvas: HTMLCanvasElement,
    pick: PickPoint,
    private readonly onChange: () => void,
  ) {
    for (const camera of [this.perspective, this.orthographic, this.handled]) camera.up.set(0, 0, 1);
    this.handled.position.set(...homeDirection(undefined)).multiplyScalar(4);
    this.controls = new CameraControls(this.handled, canvas);
    this.controls.updateCameraUp();
    void this.controls.setLookAt(...this.handled.position.toArray(), 0, 0, 0);
    this.controls.dollyToCursor = true;
    this.controls.mouseButtons.wheel = CameraControls.ACTION.NONE;
    this.gestures = new ZoomGestures(canvas, this, pick);
    // Bounds are set with the first surface; a link's pose may come before.
    this.controls.minDistance = 0;
    for (const type of ["controlstart", "control", "transitionstart", "wake", "update"] as const) {
      this.controls.addEventListener(type, onChange);
    }
    canvas.addEventListener("keydown", (event) => this.keyDown(event));
    reducedMotion.addEventListener("change", () => this.setPace());
    this.setPace();
    this.follow();
  }

  get camera(): PerspectiveCamera | OrthographicCamera {
    return this.projectionInUse === "perspective" ? this.perspective : this.orthographic;
  }

  /** A plain object that `restore` takes; while the camera moves, its current pose. */
  get pose(): CameraPose {
    const target = this.controls.getTarget(new Vector3(), false).multiplyScalar(this.unit);
    return { position: this.perspective.position.toArray(), target: this.stretch.undo(target).toArray(), projection: this.projectionInUse };
  }

  /** What the camera sees at a pose. */
  sight(pose = this.pose): Sight {
    const shown = (place: Vec3) => this.stretch.apply(new Vector3(...place));
    return sightOf(pose, this.fov, shown(pose.position).distanceTo(shown(pose.target)));
  }

  /**
   * Factor by which heights are exaggerated. Poses, points and boxes stay those of the world: the camera's matrices contain the factor, so that it applies to all
   * that is drawn. The controls move and turn in the exaggerated world.
   */
  set exaggeration(factor: number) {
    if (factor === this.stretch.factor) return;
    const { position, target } = this.pose;
    const [from, at] = [new Vector3(...position), new Vector3(...target)];
    // The camera looks from the same direction at the same place.
    const away = this.stretch.apply(from).sub(this.stretch.apply(at.clone()));
    this.stretch = new Stretch(factor);
    this.bound(this.box, this.around);
    this.lookAt(this.stretch.undo(this.stretch.apply(at.clone()).add(away)), at, false);
  }

  restore({ position, target, projection = this.projectionInUse }: PoseToRestore, animate = false): void {
    this.projection = projection;
    this.lookAt(new Vector3(...position), new Vector3(...target), animate);
  }

  get projection(): Projection {
    return this.projectionInUse;
  }

  set projection(projection: Projection) {
    this.projectionInUse = projection;
    this.follow();
    this.onChange();
  }

  /** Width over height of the picture. The smaller field of view stays the same: what was in sight before a resize is so after it. */
  set aspect(aspect: number) {
    this.fov = verticalFov(FOV, aspect);
    for (const camera of [this.perspective, this.handled]) {
      camera.aspect = aspect;
      camera.fov = (this.fov * 180) / Math.PI;
    }
    this.handled.updateProjectionMatrix();
    this.follow();
  }

  /** A camera at a pose, for an image. */
  at({ position, target, projection }: CameraPose): PerspectiveCamera | OrthographicCamera {
    const camera = projection === "perspective" ? this.perspective.clone() : this.orthographic.clone();
    this.place(camera, this.stretch.apply(new Vector3(...position)), this.stretch.apply(new Vector3(...target)));
    return camera;
  }

  zoomTowards(point: Vec3 | undefined, [x, y]: PlaceInPicture, factor: number): void {
    const { controls, unit, handled } = this;
    const now = { position: controls.getPosition(new Vector3()), target: controls.getTarget(new Vector3()) };
    const at = point && this.stretch.apply(new Vector3(...point)).divideScalar(unit);
    const from = at === undefined ? now : focused(now, at, this.projectionInUse);
    const height = Math.tan(this.fov / 2) * from.position.distanceTo(from.target);
    const beside = new Vector3(x * height * handled.aspect, y * height, 0).applyQuaternion(handled.quaternion);
    const next = zoomed(from, at ?? from.target.clone().add(beside), factor, [controls.minDistance, controls.maxDistance]);
    this.moveTo(factor > 1 ? this.keptNear(next) : next, true);
  }

  /** With its target in the box of what is shown. */
  private keptNear({ position, target }: Viewpoint): Viewpoint {
    if (this.box.isEmpty()) return { position, target };
    const inside = this.stretch.box(this.box).clampPoint(target.clone().multiplyScalar(this.unit), new Vector3()).divideScalar(this.unit);
    return { position: position.clone().sub(target).add(inside), target: inside };
  }

  focus(point: Vec3): void {
    const { controls, unit } = this;
    const now = { position: controls.getPosition(new Vector3()), target: controls.getTarget(new Vector3()) };
    this.moveTo(focused(now, this.stretch.apply(new Vector3(...point)).divideScalar(unit), this.projectionInUse), false);
  }

  /** In units of the controls. */
  private moveTo({ position, target }: Viewpoint, animate: boolean): void {
    const { controls } = this;
    // A target beside the surface may lie outside of the boundary; the next move of the camera would pull it back.
    controls.setBoundary(this.boundary().expandByPoint(target));
    void controls.setLookAt(...position.toArray(), ...target.toArray(), animate);
    this.onChange();
  }

  /** Of what is shown. */
  get radius(): number {
    return this.sphere.radius;
  }

  /** The smallest distance to what is seen, world units. */
  get nearest(): number {
    return NEAREST * this.sphere.radius;
  }

  /** The move of one frame; `onChange` is called while there is any. Returns whether it has moved. */
  advance(): boolean {
    const now = performance.now();
    const seconds = this.moving ? Math.min((now - this.lastAdvance) / 1000, MAX_STEP_SECONDS) : 1 / 60;
    this.lastAdvance = now;
    this.moving = this.controls.update(seconds);
    this.follow();
    return this.moving;
  }

  /**
   * Sets the bounds for the shown surfaces: near and far plane closely around them, for the depth buffer's precision, and limits of the user's
   * moves: the target inside of `box`, the distance from that of some cells to that of a small surface in sight. The camera's current pose is
   * always within the bounds: another surface does not move it.
   * @param around box of everything that is drawn, which may be larger
   */
  bound(box: Box3, around: Box3 = box): void {
    if (box.isEmpty()) return;
    const { controls, unit, sphere } = this;
    this.stretch.box(box).getBoundingSphere(sphere);
    this.around = around.clone();
    this.box = box.clone();
    this.stretch.box(around.clone().union(box)).getBoundingSphere(this.drawn);
    const [target, position] = [controls.getTarget(new Vector3()), controls.getPosition(new Vector3())];
    const distance = position.distanceTo(target);
    controls.minDistance = Math.min((NEAREST * sphere.radius) / unit, distance);
    controls.maxDistance = Math.max((FARTHEST * sphere.radius) / unit, distance);
    controls.setBoundary(this.boundary().expandByPoint(target));
    this.follow();
  }

  /** Of targets, in units of the controls. */
  private boundary(): Box3 {
    const { min, max } = this.stretch.box(this.box);
    return new Box3(min.divideScalar(this.unit), max.divideScalar(this.unit));
  }

  /**
   * Looks at the middle of `box` from a distance at which all `points` are in view.
   * @param back from the target to the camera; without one the direction stays
   */
  fit(box: Box3, points: readonly Vector3[], back?: Vec3, animate = false): void {
    const { stretch } = this;
    this.measureIn(stretch.box(box).getSize(new Vector3()).length() / 2);
    this.bound(box, this.around);
    const direction = back === undefined ? this.controls.getPosition(new Vector3()).sub(this.controls.getTarget(new Vector3())) : new Vector3(...back);
    direction.normalize();
    const center = stretch.box(box).getCenter(new Vector3());
    const distance = fitDistance(points.map((point) => stretch.apply(point.clone())), center, direction, this.handled.up, this.fov, this.handled.aspect);
    this.lookAt(stretch.undo(center.clone().addScaledVector(direction, FIT_MARGIN * distance)), stretch.undo(center), animate);
  }

  /** Changes the unit of the controls; the camera stays. */
  private measureIn(unit: number): void {
    if (unit === this.unit || !(unit > 0)) return;
    const { position, target } = this.pose;
    this.unit = unit;
    this.controls.setBoundary();
    this.controls.minDistance = 0;
    this.controls.maxDistance = Infinity;
    this.lookAt(new Vector3(...position), new Vector3(...target), false);
  }

  private lookAt(position: Vector3, target: Vector3, animate: boolean): void {
    const inUnits = (v: Vector3) => this.stretch.apply(v.clone()).divideScalar(this.unit).toArray();
    void this.controls.setLookAt(...inUnits(position), ...inUnits(target), animate);
    if (!animate) {
      this.controls.update(0);
      this.follow();
    }
    this.onChange();
  }

  private setPace(): void {
    this.controls.smoothTime = reducedMotion.matches ? 0 : MOVE_SECONDS;
    this.controls.draggingSmoothTime = reducedMotion.matches ? 0 : DRAG_SECONDS;
  }

  /** Moves both cameras of the picture to the position of the handled one. */
  private follow(): void {
    const target = this.controls.getTarget(new Vector3(), false).multiplyScalar(this.unit);
    const position = this.handled.position.clone().multiplyScalar(this.unit);
    for (const camera of [this.perspective, this.orthographic]) this.place(camera, position, target);
  }

  /** Puts a camera somewhere in the world as it is shown, its near and far plane closely around what is shown. */
  private place(camera: PerspectiveCamera | OrthographicCamera, position: Vector3, target: Vector3): void {
    camera.matrixWorldAutoUpdate = true;
    camera.position.copy(position);
    camera.lookAt(target);
    const { center, radius } = this.drawn;
    const away = position.distanceTo(center);
    camera.far = away + 1.01 * radius;
    camera.near = away - 1.01 * radius;
    if (camera instanceof PerspectiveCamera) {
      camera.near = Math.max(camera.near, camera.far / 2000);
    } else {
      // Things behind the camera are in the picture too: `near` may be negative.
      camera.top = position.distanceTo(target) * Math.tan(this.fov / 2);
      camera.bottom = -camera.top;
      camera.right = camera.top * this.perspective.aspect;
      camera.left = -camera.right;
    }
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.stretchView(camera);
  }

  /** Makes the camera's matrices map from the world to the picture, and its position one of the world. */
  private stretchView(camera: PerspectiveCamera | OrthographicCamera): void {
    const { factor } = this.stretch;
    camera.matrixWorldAutoUpdate = factor === 1;
    if (factor === 1) return;
    camera.matrixWorldInverse.multiply(new Matrix4().makeScale(1, 1, factor));
    camera.matrixWorld.premultiply(new Matrix4().makeScale(1, 1, 1 / factor));
    this.stretch.undo(camera.position);
  }

  private keyDown(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key];
    const { controls } = this;
    if (arrow !== undefined) {
      const [right, up] = arrow;
      if (event.shiftKey) void controls.truck(KEY_MOVE * controls.distance * right, -KEY_MOVE * controls.distance * up, true);
      else void controls.rotate(KEY_TURN * right, -KEY_TURN * up, true);
    } else if (event.key === "+" || event.key === "=") {
      void this.gestures.zoomAtCentre(1 - KEY_ZOOM);
    } else if (event.key === "-" || event.key === "_") {
      void this.gestures.zoomAtCentre(1 / (1 - KEY_ZOOM));
    } else return;
    event.preventDefault();
    this.onChange();
  }
}

/** Right and up. */
const ARROWS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};
