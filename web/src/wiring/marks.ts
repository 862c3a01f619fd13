/** What is marked in the picture: measurements, regions of interest, the crosshair of slices. */

import { Throttle } from "../net/throttle";
import type { Vec3, View, VolumeInfo } from "../protocol/types";
import type { Outlined } from "../scene/outlines";
import type { SurfaceRenderer } from "../scene/renderer";
import { lengthUnit } from "../state/lengths";
import type { Measure } from "../state/measure";
import type { PageLayers } from "../state/page";
import { crosshairOf, type Slicing } from "../state/slicing";
import type { Store } from "../state/store";
import { amountWords } from "../ui/cards/measureWords";
import { worldOf, type PlacedGrid, type Triple } from "../world/places";

const COLOR = "#10161d";

const middle = (a: Vec3, b: Vec3): Vec3 => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2];

/** Pixels by which texts stand beside their places: those of angles below, so that another one above can be read too. */
const RAISED = { distance: 16, angle: -18, reading: 16, label: 16 } as const;

/** Place of a measure's text: the middle of a distance, the corner of an angle. */
function placeOf({ kind, points }: Measure): Vec3 {
  if (kind === "distance") return middle(...points);
  return kind === "angle" ? points[1] : points[0];
}

/** What was measured, and the points of what is being measured. */
export class Measuring {
  private shown: readonly unknown[] = [];

  constructor(private readonly scene: Pick<SurfaceRenderer, "annotations">) {}

  /**
   * @param picked points of what is being measured
   * @param unit of lengths, if it is known
   */
  show(measures: readonly Measure[], picked: readonly Vec3[], unit: string | undefined): void {
    const wanted = [measures, picked, unit];
    // If nothing has changed, no frame is rendered.
    if (wanted.every((one, i) => one === this.shown[i])) return;
    const isEmpty = measures.length + picked.length === 0;
    if (isEmpty && this.shown.length === 0) return;
    this.shown = isEmpty ? [] : wanted;
    const { annotations } = this.scene;
    annotations.mark([...measures.flatMap(({ points }) => [...points]), ...picked].map((position) => ({ position, color: COLOR })));
    annotations.measure([
      ...measures.map((measure, i) => ({ points: measure.points, text: measure.kind === "label" ? measure.text : `${i + 1} · ${amountWords(measure, unit)}`, at: placeOf(measure), raised: RAISED[measure.kind] })),
      ...picked.slice(1, 2).map((point, i) => ({ points: [picked[i] ?? point, point], text: "", at: point, raised: 0 })),
    ]);
  }
}

/** The regions of interest of the selected surface, while the page is about them. */
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

const withAxis = (index: Triple, axis: number, value: number): Triple => [axis === 0 ? value : index[0], axis === 1 ? value : index[1], axis === 2 ? value : index[2]];

/** Its lines go from the volume's first samples to its last ones. */
export function crosshairPlace(grid: PlacedGrid, at: Triple): { readonly at: Triple; readonly ends: readonly (readonly [Triple, Triple])[] } {
  const end = (axis: number, value: number) => worldOf(grid, withAxis(at, axis, value));
  return { at: worldOf(grid, at), ends: grid.dims.map((count, axis) => [end(axis, 0), end(axis, count - 1)] as const) };
}

/** Minimum interval between frames while the crosshair is dragged: a CPU renders the surface again for each frame, which would delay the slices. */
const INTERVAL_MS = { gpu: 0, processor: 200 } as const;

/** The crosshair of the slices in the picture beside them. */
class Pointing {
  private shown = "";
  private place: ReturnType<typeof crosshairPlace> | undefined;
  private readonly throttle: Throttle;

  constructor(scene: Pick<SurfaceRenderer, "annotations" | "onGpu">) {
    this.throttle = new Throttle(scene.onGpu ? INTERVAL_MS.gpu : INTERVAL_MS.processor, () => scene.annotations.point(this.place));
  }

  show(slicing: Slicing, volume: VolumeInfo | undefined): void {
    const at = volume === undefined || slicing.layout !== "both" ? undefined : crosshairOf(slicing, volume.geometry.dims);
    // If nothing has changed, no frame is rendered.
    const wanted = at === undefined ? "" : `${volume?.id} ${at.join()}`;
    if (wanted === this.shown) return;
    this.shown = wanted;
    this.place = volume === undefined || at === undefined ? undefined : crosshairPlace(volume.geometry, at);
    this.throttle.call();
  }
}

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
