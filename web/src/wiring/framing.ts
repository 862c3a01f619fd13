/** Where the camera looks when a surface is first shown, and where buttons send it. */

import type { SurfaceRenderer } from "../scene/renderer";
import type { Vec3 } from "../protocol/types";
import type { Pose } from "../state/look";
import type { Actions } from "../ui/actions";
import type { AxisName } from "../world/axes";

export class Framing {
  /** The next surface on screen is the first of its volume, and the camera is fitted to it, or put where it was. */
  private due = true;
  private first: Pose | undefined;
  private times = 0;

  /** @param onMove the camera was sent somewhere */
  constructor(
    private readonly scene: SurfaceRenderer,
    private readonly onMove: () => void,
  ) {}

  /** How often the camera was sent to where the whole surface is in sight. */
  get fitted(): number {
    return this.times;
  }

  /** Where the camera is; `undefined` while there is nothing to look at. */
  get pose(): Pose | undefined {
    return this.scene.regionCount > 0 && !this.due ? this.scene.camera.pose : undefined;
  }

  /** @param pose where the camera shall be then */
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

  featureSpan(number: number): readonly [number, number] | undefined {
    return this.scene.colors.featureSpan(number);
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

/** What the page does with the camera, of which there is none until the page has been made. */
export function framingActions(framing: () => Framing): Pick<Actions, "fit" | "home" | "lookFrom" | "facing" | "featureSpan"> {
  return {
    fit: () => framing().fit(),
    home: () => framing().home(),
    lookFrom: (axis) => framing().lookFrom(axis),
    featureSpan: (number) => framing().featureSpan(number),
    facing: (normal) => framing().facing(normal),
  };
}
