/** Sums up the selected surface for one card, and any surfaces for another. */

import { createSignal, type Accessor } from "solid-js";
import type { RegionPipeline } from "../regions/pipeline";
import type { Enclosed } from "../state/enclosed";
import type { Store } from "../state/store";
import { selectSurface } from "../state/surfaceState";
import type { Model, SurfaceSums } from "../ui/model";
import { Enclosing } from "./enclosing";

type Sums = ReadonlyMap<number, Enclosed | "summing">;

export class Summing implements SurfaceSums {
  private readonly ofSelected: Enclosing;
  private readonly ofEach = new Map<number, Enclosing>();
  private readonly setKnown: (sums: Sums) => void;
  readonly known: Accessor<Sums>;

  constructor(
    private readonly store: Store,
    private readonly model: Model,
    private readonly pipeline: RegionPipeline,
  ) {
    const [known, setKnown] = createSignal<Sums>(new Map());
    [this.known, this.setKnown] = [known, (sums) => setKnown(sums)];
    this.ofSelected = new Enclosing(store, model, pipeline);
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
    const { model, store, pipeline } = this;
    const source = {
      get viewer() {
        return selectSurface(store.viewer, number);
      },
    };
    const made = new Enclosing(source, { showEnclosed: (sums) => this.show(number, sums), toast: (text) => model.toast(text) }, pipeline);
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
