/** What the colours of the surfaces stand for: the blended feature, a field on a scale, or a value of each vertex. */

import type { Surfaces } from "./surfaces";

export class SurfaceColors {
  constructor(
    private readonly surfaces: Surfaces,
    private readonly onChange: () => void,
  ) {}

  setAlpha(alpha: number, surface = 0): void {
    // Set after every edit; if α is the same, the frame would be too.
    if (this.surfaces.of(surface).alpha === alpha) return;
    this.surfaces.of(surface).alpha = alpha;
    this.onChange();
  }

  /** RGBA bytes over the blended feature. */
  setTransfer(table: Uint8Array<ArrayBuffer>, surface = 0, regions: Parameters<Surfaces["setTransfer"]>[2] = []): void {
    this.surfaces.setTransfer(table, surface, regions);
    this.onChange();
  }

  /** What the colours of colour mode `field` stand for. */
  setField(colors: Parameters<Surfaces["setField"]>[0], surface: number): void {
    this.surfaces.setField(colors, surface);
    this.onChange();
  }

  /** What colour mode `value` shows: values from `low` to `high` in the colours of a table, RGBA bytes. */
  setValueColors(low: number, high: number, table: Uint8Array<ArrayBuffer>): void {
    this.surfaces.setValueColors(low, high, table);
    this.onChange();
  }

  /** The minimum and the maximum on a surface that is shown, of the feature, 0 to 1, or of the field's values; `undefined` if it has none. */
  span(surface: number, of: "feature" | "values"): readonly [number, number] | undefined {
    return this.surfaces.span(surface, of);
  }
}
