/** What is marked in the picture: measurements, regions of interest, the crosshair of slices. */

import type { SurfaceRenderer } from "../scene/renderer";
import { lengthUnit } from "../state/lengths";
import type { Store } from "../state/store";
import { Measuring } from "./measuring";
import { Outlining } from "./outlining";
import { Pointing } from "./pointing";

export class Marks {
  private readonly measuring: Measuring;
  private readonly outlining: Outlining;
  private readonly pointing: Pointing;

  constructor(scene: Pick<SurfaceRenderer, "annotations" | "onGpu">) {
    this.measuring = new Measuring(scene);
    this.outlining = new Outlining(scene);
    this.pointing = new Pointing(scene);
  }

  show({ isEmbedded, look, page, view, viewer }: Pick<Store, "isEmbedded" | "look" | "page" | "view" | "viewer">): void {
    this.measuring.show(look.measures, page.picked, lengthUnit(viewer.volume));
    this.outlining.show(view?.interest ?? [], page);
    if (!isEmbedded) this.pointing.show(page.slicing, viewer.volume);
  }
}
