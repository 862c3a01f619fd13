/** Goes through all time steps once and measures the surface in each: the same as the user would do by hand. Loaded when it is asked for. */

import type { Probed, Vec3 } from "../protocol/types";
import { isSameSurface } from "../protocol/view";
import { enclosedOf, type Enclosed } from "../state/enclosed";
import type { Store } from "../state/store";
import { MAX_CURVE_POINTS, type StepRow, type TimeCurves } from "../state/timeCurves";
import { stepCount } from "../state/timeSteps";

export interface TimeMeasuringHandlers {
  /** The step that was asked for last is on screen, as a whole. */
  readonly isShown: () => boolean;
  readonly go: (step: number) => void;
  /** To the step before the first `go`. */
  readonly back: () => void;
  readonly sum: () => Promise<Parameters<typeof enclosedOf>[0]>;
  readonly probe: (position: Vec3) => Promise<Probed | undefined>;
  readonly show: (curves: TimeCurves) => void;
  readonly fail: (reason: string) => void;
}

export class TimeMeasuring {
  private curves: TimeCurves | undefined;
  private isBusy = false;

  constructor(
    private readonly store: Pick<Store, "look" | "step" | "view" | "viewer">,
    private readonly on: TimeMeasuringHandlers,
  ) {}

  /** At the points whose values were read (card Measure). */
  start(): void {
    const { look, view, viewer } = this.store;
    if (view === undefined || viewer.volume === undefined || this.curves?.isRunning === true) return;
    const points = look.measures.flatMap((measure) => (measure.kind === "reading" ? measure.points : [])).slice(0, MAX_CURVE_POINTS);
    this.show({ volume: viewer.volume.id, of: view, field: view.field, count: stepCount(viewer), points, rows: [], isRunning: true });
    this.on.go(0);
    this.follow();
  }

  /** Keeps what is measured. */
  stop(): void {
    if (this.curves?.isRunning !== true) return;
    this.show({ ...this.curves, isRunning: false });
    if (this.curves.volume === this.store.viewer.volume?.id) this.on.back();
  }

  /** Something has changed: what is on screen, or what is wanted. */
  follow(): void {
    const { curves, store } = this;
    if (curves?.isRunning !== true || this.isBusy) return;
    const next = curves.rows.length;
    // The surface or the time step was changed by other means.
    const { view, viewer } = store;
    const isSame = curves.volume === viewer.volume?.id && view !== undefined && isSameSurface(curves.of, view);
    if (!isSame || store.step !== next) return this.giveUp(curves);
    if (viewer.target?.step === next && this.on.isShown()) void this.measure(curves, next);
  }

  private giveUp(curves: TimeCurves): void {
    this.show({ ...curves, isRunning: false });
    this.on.fail("Measuring over time has ended: the surface or the time step was changed");
  }

  private async measure(curves: TimeCurves, step: number): Promise<void> {
    this.isBusy = true;
    try {
      const hasSurface = (this.store.viewer.statistics?.triangles ?? 0) > 0;
      const sums: Enclosed | undefined = hasSurface ? enclosedOf(await this.on.sum()) : undefined;
      const values: (number | undefined)[] = [];
      for (const point of curves.points) values.push(valueOf(await this.on.probe(point), curves.field));
      if (this.curves?.isRunning === true) this.add({ step, sums, values });
    } catch (error) {
      this.show({ ...curves, isRunning: false });
      this.on.fail(`Measuring over time has ended at step ${step + 1}: ${error instanceof Error ? error.message : String(error)}`);
    } finally {
      this.isBusy = false;
    }
    this.follow();
  }

  private add(row: StepRow): void {
    if (this.curves === undefined) return;
    const rows = [...this.curves.rows, row];
    this.show({ ...this.curves, rows });
    if (rows.length >= this.curves.count) this.stop();
    else this.on.go(rows.length);
  }

  private show(curves: TimeCurves): void {
    this.curves = curves;
    this.on.show(curves);
  }
}

function valueOf(probed: Probed | undefined, field: string): number | undefined {
  return probed?.values.find((one) => one.field === field)?.value ?? undefined;
}
