/** Gets the planes of samples that the look asks for. One request is on its way at a time; of those that come meanwhile the last one counts. */

import { isEqual } from "../protocol/equal";
import { fetchSlice, type Plane } from "../net/slices";
import type { VolumeInfo } from "../protocol/types";
import type { Slice } from "../scene/slices";
import { openingWindow } from "../state/bounds";
import type { SliceChoice } from "../state/look";
import { planesAt, type Slicing } from "../state/slicing";
import { unevenOf, type Uneven } from "../world/uneven";

/** Whose samples the slices show. */
export interface SliceSource {
  readonly volume: VolumeInfo;
  readonly step: number;
  readonly field: string;
  /** Slices beside the picture, whose crosshair those in it follow. */
  readonly slicing?: Slicing;
}

const AXES = ["x", "y", "z"] as const;

export class SliceLoader {
  private wanted: { readonly choice: SliceChoice; readonly source: SliceSource } | undefined;
  private planes: readonly Plane[] = [];
  /** What `planes` are of. */
  private loaded: ReturnType<typeof keyOf> = keyOf(undefined);
  private loading = false;
  private shown: readonly unknown[] = [];

  /** @param onError what cannot be shown, for the user */
  constructor(
    private readonly onSlices: (slices: readonly Slice[]) => void,
    private readonly onError: (reason: string) => void,
    private readonly base: URL,
    private readonly get = fetchSlice,
  ) {}

  show({ planes, window }: SliceChoice, source: SliceSource): void {
    const { slicing, volume } = source;
    this.wanted = { choice: { planes: slicing === undefined ? planes : planesAt(planes, slicing, volume.geometry.dims), window }, source };
    this.place();
    if (!this.loading) void this.load();
  }

  private async load(): Promise<void> {
    this.loading = true;
    try {
      // Until what is loaded is what is wanted.
      for (let key = keyOf(this.wanted); !isEqual(key, this.loaded); key = keyOf(this.wanted)) {
        const planes = await this.request();
        this.planes = planes;
        this.loaded = key;
        if (isEqual(key, keyOf(this.wanted))) this.place();
      }
    } catch (error) {
      this.planes = [];
      this.onError(`The slices cannot be shown: ${error instanceof Error ? error.message : String(error)}`);
    } finally {
      this.loading = false;
    }
  }

  private request(): Promise<readonly Plane[]> {
    const { wanted } = this;
    if (wanted === undefined) return Promise.resolve([]);
    const { volume, step, field } = wanted.source;
    const asked = planesOf(wanted.choice, volume);
    return Promise.all(asked.map(({ axis, index }) => this.get(this.base, { volume: volume.id, step, field, axis, index })));
  }

  /** Shows the planes that are loaded, unless they are shown already, or are of another volume or step. */
  private place(): void {
    if (this.wanted === undefined) return;
    const { choice, source } = this.wanted;
    const planes = isEqual(this.loaded.source, keyOf(this.wanted).source) ? this.planes : [];
    const [black, white] = choice.window ?? openingWindow(source.volume, source.field, () => planes.map(({ samples }) => samples));
    const state = [black, white, ...planes];
    if (state.length === this.shown.length && state.every((value, i) => value === this.shown[i])) return;
    // Without planes the window does not matter.
    const isEmpty = planes.length === 0 && this.shown.length <= 2;
    this.shown = state;
    const uneven = unevenOf(source.volume.geometry);
    if (!isEmpty) this.onSlices(planes.map((plane) => ({ ...plane, ...linesOf(plane, uneven), window: [black, white] })));
  }
}

type Wanted = { readonly choice: SliceChoice; readonly source: SliceSource };

function keyOf(wanted: Wanted | undefined) {
  if (wanted === undefined) return { source: undefined, planes: [] };
  const { volume, step, field } = wanted.source;
  return { source: { volume: volume.id, step, field }, planes: planesOf(wanted.choice, volume) };
}

/** Positions of the samples of a plane, if they are not even. */
function linesOf({ axes }: Plane, uneven: Uneven | undefined): Pick<Slice, "lines"> {
  const along = (name: "x" | "y" | "z" | undefined) => (name === undefined ? null : uneven?.[AXES.indexOf(name)] ?? null);
  return uneven === undefined || axes === undefined ? {} : { lines: [along(axes[0]), along(axes[1])] };
}

/** Those that there are: a link may ask for others. */
function planesOf({ planes }: SliceChoice, { geometry }: VolumeInfo): readonly { readonly axis: "x" | "y" | "z"; readonly index: number }[] {
  return AXES.flatMap((axis, i) => {
    const index = planes[i];
    return index === null || index === undefined ? [] : [{ axis, index: Math.min(index, (geometry.dims[i] ?? 1) - 1) }];
  });
}
