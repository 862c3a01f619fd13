/** Shows the regions of interest of the selected surface in the picture, while the page is about them. */

import type { View } from "../protocol/types";
import type { Outlined } from "../scene/outlines";
import type { SurfaceRenderer } from "../scene/renderer";
import type { PageLayers } from "../state/store";

export class Outlining {
  private shown: View["interest"] = [];
  private strong: number | undefined;

  constructor(private readonly scene: Pick<SurfaceRenderer, "annotations">) {}

  show(interest: View["interest"], { inspector, outlined }: Pick<PageLayers, "inspector" | "outlined">): void {
    const wanted = inspector && outlined !== undefined ? interest : [];
    const strong = typeof outlined === "number" ? outlined : undefined;
    // If nothing has changed, no frame is rendered.
    if ((wanted === this.shown && strong === this.strong) || wanted.length + this.shown.length === 0) return;
    [this.shown, this.strong] = [wanted, strong];
    this.scene.annotations.outline(wanted.flatMap(({ sphere, box }): Outlined[] => (sphere !== undefined ? [sphere] : box !== undefined ? [box] : [])), strong);
  }
}
