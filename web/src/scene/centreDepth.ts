/** How far before the camera the surface at the centre of the picture is, where the scale bar holds. It is looked for when the picture is still. */

import { Vector3 } from "three";
import type { SceneCamera } from "./camera";
import type { Painter } from "./painter";

/** The picture is still if no frame was rendered for this time. */
const STILL_MS = 200;

export class CentreDepth {
  /** On the line of sight, when it was last looked for. */
  private found: Vector3 | undefined;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly camera: SceneCamera,
    private readonly painter: Pick<Painter, "depths">,
    private readonly onFound: () => void,
  ) {}

  /** World units; to the target if there is no surface. While the camera moves, to the place that was found last. */
  get depth(): number {
    const { position, forward, target } = this.line();
    return Math.max((this.found ?? target).clone().sub(position).dot(forward), 1e-3 * this.camera.nearest);
  }

  /** Looks for it when the picture is still: it costs as much as a frame of few pixels. */
  lookSoon(isShown: boolean): void {
    clearTimeout(this.timer);
    if (isShown && this.camera.projection === "perspective") this.timer = setTimeout(() => void this.look(), STILL_MS);
  }

  private async look(): Promise<void> {
    const { position, forward } = this.line();
    const { centre } = await this.painter.depths(this.camera.camera);
    this.found = centre === undefined ? undefined : position.addScaledVector(forward, centre);
    this.onFound();
  }

  private line(): { readonly position: Vector3; readonly forward: Vector3; readonly target: Vector3 } {
    const { pose } = this.camera;
    const [position, target] = [new Vector3(...pose.position), new Vector3(...pose.target)];
    return { position, target, forward: target.clone().sub(position).normalize() };
  }
}
