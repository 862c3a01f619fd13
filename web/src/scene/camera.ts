/** The camera: orbited by the user with damping, fitted to the surface. */

import { PerspectiveCamera, Vector3, type Box3, type Sphere } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { fitDistance } from "./world";

const FOV_DEGREES = 32;
const DAMPING = 0.12;
/** After this many steps of damping a millionth of the movement is left. */
const SETTLE_STEPS = Math.ceil(Math.log(1e-6) / Math.log(1 - DAMPING));
/** Empty border around a fitted surface, as a factor on the distance. */
const FIT_MARGIN = 1.04;
/** From the front, left and above, for volumes whose world is right, anterior, superior. */
const FIRST_DIRECTION = new Vector3(-0.72, 0.58, 0.38).normalize();

export class OrbitCamera {
  readonly camera = new PerspectiveCamera(FOV_DEGREES, 1, 0.1, 10);
  private readonly controls: OrbitControls;
  /** Damping still moves the camera. */
  private damping = false;

  /** `onChange`: the camera moved or is about to; `advance` has to be called in the next frame. */
  constructor(canvas: HTMLCanvasElement, onChange: () => void) {
    this.camera.up.set(0, 0, 1);
    this.camera.position.copy(FIRST_DIRECTION).multiplyScalar(4);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = DAMPING;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", onChange);
    this.controls.addEventListener("start", onChange);
  }

  /** Position and point looked at, in world units. */
  get pose(): { readonly position: readonly number[]; readonly target: readonly number[] } {
    return { position: this.camera.position.toArray(), target: this.controls.target.toArray() };
  }

  /** Width over height of the picture. */
  set aspect(aspect: number) {
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
  }

  /** Damping's movement of one frame; `onChange` is called where there is any. */
  advance(): void {
    if (this.controls.update()) {
      this.damping = true;
    } else if (this.damping) {
      // What is left is too small to see. Without this it would move the camera in later frames.
      this.damping = false;
      for (let i = 0; i < SETTLE_STEPS; i += 1) this.controls.update();
    }
  }

  /** Sets near and far plane closely around a sphere, for the depth buffer's precision. */
  clipTo({ center, radius }: Sphere): void {
    const distance = this.camera.position.distanceTo(center);
    this.camera.far = distance + 1.01 * radius;
    this.camera.near = Math.max(distance - 1.01 * radius, this.camera.far / 2000);
    this.camera.updateProjectionMatrix();
  }

  /**
   * Looks at the middle of `box` from where all `points` are in view.
   * @param fromFirstDirection from the direction of a page just opened; otherwise the direction stays
   */
  fit(box: Box3, points: readonly Vector3[], fromFirstDirection: boolean): void {
    const { camera, controls } = this;
    const back = fromFirstDirection ? FIRST_DIRECTION.clone() : camera.position.clone().sub(controls.target).normalize();
    const center = box.getCenter(controls.target);
    const fov = (FOV_DEGREES * Math.PI) / 180;
    const distance = fitDistance(points, center, back, camera.up, fov, camera.aspect);
    camera.position.copy(controls.target).addScaledVector(back, FIT_MARGIN * distance);
    controls.update();
  }
}
