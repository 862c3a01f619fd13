/** The world as it is shown: higher than it is by a factor. Pure. */

import type { Box3, Vector3 } from "three";

export class Stretch {
  constructor(readonly factor: number) {}

  /** Changes a position of the world to the one at which it is shown, and returns it. */
  apply(place: Vector3): Vector3 {
    return place.setZ(place.z * this.factor);
  }

  /** The inverse of `apply`. */
  undo(place: Vector3): Vector3 {
    return place.setZ(place.z / this.factor);
  }

  box(box: Box3): Box3 {
    const shown = box.clone();
    if (!shown.isEmpty()) [shown.min, shown.max].forEach((corner) => this.apply(corner));
    return shown;
  }
}
