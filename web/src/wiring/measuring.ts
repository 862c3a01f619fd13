/** Shows in the scene what was measured, and the points of what is being measured. */

import type { SurfaceRenderer } from "../scene/renderer";
import type { Vec3 } from "../protocol/types";
import type { Measure } from "../state/measure";
import { amountWords } from "../ui/cards/measureWords";

const COLOR = "#10161d";

const middle = (a: Vec3, b: Vec3): Vec3 => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2];

/** Pixels by which texts stand beside their places: those of angles below, so that another one above can be read too. */
const RAISED = { distance: 16, angle: -18, reading: 16, label: 16 } as const;

/** Place of a measure's text: the middle of a distance, the corner of an angle. */
function placeOf({ kind, points }: Measure): Vec3 {
  if (kind === "distance") return middle(...points);
  return kind === "angle" ? points[1] : points[0];
}

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
