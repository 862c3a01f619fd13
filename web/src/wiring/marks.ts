/** What is marked in the picture: measurements, and regions of interest. */

import type { SurfaceRenderer } from "../scene/renderer";
import { lengthUnit } from "../state/lengths";
import type { Store } from "../state/store";
import { Measuring } from "./measuring";
import { Outlining } from "./outlining";

export class Marks {
  private readonly measuring: Measuring;
  private readonly outlining: Outlining;

  constructor(scene: Pick<SurfaceRenderer, "annotations">) {
    this.measuring = new Measuring(scene);
    this.outlining = new Outlining(scene);
  }

  show({ look, page, view, viewer }: Pick<Store, "look" | "page" | "view" | "viewer">): void {
    this.measuring.show(look.measures, page.picked, lengthUnit(viewer.volume));
    this.outlining.show(view?.interest ?? [], page);
  }
}
