/** Sums up area and volume of surfaces when the user asks: the selected one for one card, any for another. */

import { createSignal, type Accessor } from "solid-js";
import type { RegionPipeline } from "../regions/pipeline";
import type { Vec3, VolumeInfo } from "../protocol/types";
import { enclosedOf, type Enclosed } from "../state/enclosed";
import type { Store } from "../state/store";
import type { ShownPrefix } from "../state/surfaceState";
import { seen, type SeenSurface } from "../state/viewer";
import type { Model, SurfaceSums } from "../ui/model";
import { unevenOf } from "../world/uneven";

/** World vectors of one step along each axis of the even grid. */
export function axesOf({ direction, spacing }: Pick<VolumeInfo["geometry"], "direction" | "spacing">): [Vec3, Vec3, Vec3] {
  const step = (axis: 0 | 1 | 2): Vec3 => [direction[axis][0] * spacing[axis], direction[axis][1] * spacing[axis], direction[axis][2] * spacing[axis]];
  return [step(0), step(1), step(2)];
}

/** The sums of one surface; forgotten when another surface is shown. */
export class Enclosing {
  /** What is on screen of the surface that is summed up: a further object with each change. */
  private of: ShownPrefix | undefined;
  /** Generation of the last edit of that surface: later ones are for cameras. */
  private edited: number | undefined;

  constructor(
    private readonly store: { readonly viewer: SeenSurface },
    private readonly show: (sums: Enclosed | "summing" | undefined) => void,
    private readonly onError: (reason: string) => void,
    private readonly pipeline: Pick<RegionPipeline, "sum">,
    private readonly isStill: () => boolean = () => true,
  ) {}

  async sum(): Promise<void> {
    const { shown, volume } = this.store.viewer;
    if (shown === undefined || volume === undefined) return;
    this.show("summing");
    await this.sumAgain();
  }

  private async sumAgain(): Promise<void> {
    const { edited, shown, selected, volume } = this.store.viewer;
    if (shown === undefined || volume === undefined) return;
    [this.of, this.edited] = [shown, edited];
    const isOfNow = () => this.of === shown && this.store.viewer.shown === shown;
    try {
      const sums = await this.pipeline.sum(selected, axesOf(volume.geometry), unevenOf(volume.geometry));
      if (isOfNow()) this.show(enclosedOf(sums));
    } catch (error) {
      if (!isOfNow()) return;
      this.of = undefined;
      this.show(undefined);
      this.onError(`Area and volume could not be summed up: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  /** Something may have changed. A better surface of the same values is summed up in its turn, and one for another camera once that is still. */
  follow(): void {
    const { of } = this;
    const { edited, shown } = this.store.viewer;
    if (of === undefined || of === shown) return;
    if (shown?.generation === of.generation) return void this.sum();
    if (shown !== undefined && edited !== undefined && edited === this.edited) {
      if (this.isStill()) void this.sumAgain();
      return;
    }
    this.of = undefined;
    this.show(undefined);
  }
}

type Sums = ReadonlyMap<number, Enclosed | "summing">;

export class Summing implements SurfaceSums {
  private readonly ofSelected: Enclosing;
  private readonly onError: (reason: string) => void;
  private readonly ofEach = new Map<number, Enclosing>();
  private readonly setKnown: (sums: Sums) => void;
  readonly known: Accessor<Sums>;

  constructor(
    private readonly store: Store,
    model: Model,
    private readonly pipeline: RegionPipeline,
    private readonly isStill: () => boolean,
  ) {
    const [known, setKnown] = createSignal<Sums>(new Map());
    [this.known, this.setKnown] = [known, (sums) => setKnown(sums)];
    this.onError = (reason) => model.toast(reason);
    this.ofSelected = new Enclosing(store, model.enclosed.set, this.onError, pipeline, isStill);
    model.sums = this;
  }

  sumSelected(): void {
    void this.ofSelected.sum();
  }

  sum(surfaces: readonly number[]): void {
    for (const number of surfaces) void this.enclosing(number).sum();
  }

  /** Something may have changed. */
  follow(): void {
    this.ofSelected.follow();
    for (const [number, enclosing] of this.ofEach) {
      if (this.store.surfaces.some((surface) => surface.number === number)) enclosing.follow();
      else this.forget(number);
    }
  }

  private enclosing(number: number): Enclosing {
    const known = this.ofEach.get(number);
    if (known !== undefined) return known;
    const { store, pipeline } = this;
    const source = {
      get viewer() {
        return seen(store.state.server, number);
      },
    };
    const made = new Enclosing(source, (sums) => this.show(number, sums), this.onError, pipeline, this.isStill);
    this.ofEach.set(number, made);
    return made;
  }

  private forget(number: number): void {
    this.ofEach.delete(number);
    this.show(number, undefined);
  }

  private show(number: number, sums: Enclosed | "summing" | undefined): void {
    const known = new Map(this.known());
    if (sums === undefined) known.delete(number);
    else known.set(number, sums);
    this.setKnown(known);
  }
}
