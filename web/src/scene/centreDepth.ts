/** Depth of the surface at the centre of the picture, at which the scale bar holds. It is measured when the picture is still. */

import { Vector3 } from "three";
import type { SceneCamera } from "./camera";
import type { Painter } from "./painter";
import { WhenStill } from "./whenStill";

const STILL_MS = 200;

export class CentreDepth {
  /** Point on the line of sight, from the last measurement. */
  private found: Vector3 | undefined;
  private readonly whenStill = new WhenStill(STILL_MS, () => this.look());

  constructor(
    private readonly camera: SceneCamera,
    private readonly painter: Pick<Painter, "depths">,
    private readonly onFound: () => void,
  ) {}

  /** Depth as the camera sees it; that of the target if there is no surface. While the camera moves, that of the last measured point. */
  get depth(): number {
    const place = this.found?.clone() ?? new Vector3(...this.camera.pose.target);
    return Math.max(-place.applyMatrix4(this.camera.camera.matrixWorldInverse).z, 1e-3 * this.camera.nearest);
  }

  /** Measures it when the picture is still. */
  lookSoon(isShown: boolean): void {
    this.whenStill.lookSoon(isShown && this.camera.projection === "perspective");
  }

  private async look(): Promise<void> {
    const toWorld = this.camera.camera.matrixWorld.clone();
    const { centre } = await this.painter.depths(this.camera.camera);
    this.found = centre === undefined ? undefined : new Vector3(0, 0, -centre).applyMatrix4(toWorld);
    this.onFound();
  }
}
