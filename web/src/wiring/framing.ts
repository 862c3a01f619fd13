/** The camera's pose when a surface is first shown, and the poses that buttons set. */

import type { SurfaceRenderer } from "../scene/renderer";
import type { Vec3 } from "../protocol/types";
import type { Pose } from "../state/look";
import type { AxisName } from "../world/axes";

export class Framing {
  /** The next surface on screen is the first of its volume, and the camera is fitted to it, or restored to its remembered pose. */
  private due = true;
  private first: Pose | undefined;
  private times = 0;

  /** @param onMove the camera was sent somewhere */
  constructor(
    private readonly scene: SurfaceRenderer,
    private readonly onMove: () => void,
  ) {}

  /** How often the camera was fitted to the whole surface. */
  get fitted(): number {
    return this.times;
  }

  /** The camera's pose; `undefined` while there is nothing to look at. */
  get pose(): Pose | undefined {
    return this.scene.regionCount > 0 && !this.due ? this.scene.camera.pose : undefined;
  }

  /** @param pose that the camera shall have then */
  expect(another: boolean, pose: Pose | undefined): void {
    this.first = pose;
    this.due ||= another;
  }

  /** There is something new on screen. */
  swapped(): void {
    if (!this.due || this.scene.regionCount === 0) return;
    this.due = false;
    this.move(() => this.scene.home(false));
    if (this.first !== undefined) this.scene.camera.restore(this.first);
  }

  fit(): void {
    this.move(() => this.scene.fit());
  }

  home(): void {
    this.move(() => this.scene.home());
  }

  lookFrom(axis: AxisName): void {
    this.move(() => this.scene.view(axis));
  }

  colorSpan(number: number, of: "feature" | "values"): readonly [number, number] | undefined {
    return this.scene.colors.span(number, of);
  }

  /** The normal, or its opposite, whichever points towards the camera. */
  facing(normal: Vec3): Vec3 {
    const { position, target } = this.scene.camera.pose;
    const towards = normal.reduce((sum, n, axis) => sum + n * ((position[axis] ?? 0) - (target[axis] ?? 0)), 0);
    return towards < 0 ? [-normal[0] || 0, -normal[1] || 0, -normal[2] || 0] : normal;
  }

  private move(to: () => void): void {
    to();
    this.times += 1;
    this.onMove();
  }
}
