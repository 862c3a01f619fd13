/** All visible surfaces as one GLB, each in the colour and opacity that it has on the page. */

import { extract } from "../net/rest";
import { volumeName } from "../state/fileNames";
import { labelsName } from "../state/labels";
import type { Store } from "../state/store";
import { viewerOf } from "../state/viewer";
import { linearColor } from "../transfer/model";
import { formatValue } from "../ui/format";
import type { Model } from "../ui/model";
import { exportedView, saveMade } from "../ui/takeAlong";
import { colorOf } from "./surfaceSigns";

/** Has the server make them one after the other, and saves them. */
export async function downloadAll(model: Model, store: Store, base: URL, cap = false): Promise<void> {
  const { look, viewer } = store;
  const { target } = viewer;
  if (target === undefined) return;
  const surfaces = store.surfaces.filter(({ style }) => style.visible);
  await saveMade(model, `${volumeName(viewer.volume)}-surfaces.glb`, async () => {
    const { joinGlb } = await import("../net/glb");
    const parts = [];
    for (const surface of surfaces) {
      const view = exportedView(viewerOf(viewer, { surfaces: store.surfaces, selected: surface.number }), cap && surface.view.mesher === "dual");
      if (view === undefined) continue;
      const color = colorOf(surface, look);
      const file = await (await extract(base, target.volume, target.step, "glb", view)).arrayBuffer();
      parts.push({ name: labelsName(viewer.volume, surface.view.field) ?? formatValue(surface.view.iso, 6), color: color === undefined ? undefined : linearColor(color), opacity: surface.style.opacity, file });
    }
    return joinGlb(parts);
  });
}
