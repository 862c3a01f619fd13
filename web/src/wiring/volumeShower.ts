/**
 * Shows the volume at a low resolution along the rays of the picture. It is loaded when it is first shown; one request is on its way at a time, and what was fetched
 * last is kept.
 */

import { isEqual } from "../protocol/equal";
import { fetchOverview, type Overview, type OverviewRequest } from "../net/overview";
import type { VolumeInfo } from "../protocol/types";
import { VolumePicture, type VolumeStyle } from "../scene/volumePicture";
import type { RayVolume } from "../scene/rays";

/** What is to be shown. */
export interface VolumeWanted {
  readonly volume: VolumeInfo;
  readonly step: number;
  readonly field: string;
  /** Without a window it is the range of the values. */
  readonly style: Omit<VolumeStyle, "window"> & { readonly window: VolumeStyle["window"] | undefined };
}

/** At most 2 MiB each. */
const MAX_KEPT = 8;

type Get = (base: URL, request: OverviewRequest, signal: AbortSignal) => Promise<Overview>;

const requestOf = ({ volume, step, field, style }: VolumeWanted): OverviewRequest => ({ volume: volume.id, step, field, mode: style.isMaximum ? "maximum" : "mean" });
const keyOf = (wanted: VolumeWanted) => JSON.stringify(requestOf(wanted));
/** A step that is not there yet leaves that of before in the picture; another volume or field does not. */
const isSameSource = (a: VolumeWanted, b: VolumeWanted) => a.volume.id === b.volume.id && a.field === b.field && a.style.isMaximum === b.style.isMaximum;

export class VolumeShower {
  private readonly kept = new Map<string, Overview>();
  private wanted: VolumeWanted | undefined;
  private flight: { readonly key: string; readonly abort: AbortController } | undefined;
  private shown: { readonly key: string; readonly of: VolumeWanted; readonly range: Overview["range"]; readonly picture: VolumePicture } | undefined;
  /** Asked for once: until something else is wanted it is not asked for again. */
  private failed: string | undefined;
  private style: VolumeStyle | undefined;

  /** @param onError what cannot be shown, for the user */
  constructor(
    private readonly onPicture: (picture: RayVolume | undefined) => void,
    private readonly onError: (reason: string) => void,
    private readonly base: URL,
    private readonly get: Get = fetchOverview,
  ) {}

  /** `undefined`: nothing. An unchanged picture costs no frame. */
  show(wanted: VolumeWanted | undefined): void {
    this.wanted = wanted;
    if (wanted === undefined || (this.shown !== undefined && !isSameSource(this.shown.of, wanted))) this.remove();
    if (wanted === undefined) {
      this.failed = undefined;
      this.flight?.abort.abort();
      return;
    }
    const key = keyOf(wanted);
    if (this.failed !== key) this.failed = undefined;
    const found = this.kept.get(key);
    if (found !== undefined) this.place(wanted, found);
    else if (this.flight === undefined && this.failed === undefined) void this.load(wanted);
    else if (this.flight !== undefined && this.flight.key !== key) this.flight.abort.abort();
    this.restyle();
  }

  private async load(wanted: VolumeWanted): Promise<void> {
    const key = keyOf(wanted);
    const abort = new AbortController();
    this.flight = { key, abort };
    try {
      this.keep(key, await this.get(this.base, requestOf(wanted), abort.signal));
    } catch (error) {
      if (!abort.signal.aborted && this.wanted !== undefined && keyOf(this.wanted) === key) {
        this.failed = key;
        this.onError(`The volume cannot be shown: ${error instanceof Error ? error.message : String(error)}`);
      }
    }
    this.flight = undefined;
    this.show(this.wanted);
  }

  private keep(key: string, overview: Overview): void {
    this.kept.set(key, overview);
    const [oldest] = this.kept.keys();
    if (this.kept.size > MAX_KEPT && oldest !== undefined) this.kept.delete(oldest);
  }

  private place(wanted: VolumeWanted, overview: Overview): void {
    const key = keyOf(wanted);
    if (this.shown?.key === key) return;
    this.shown?.picture.dispose();
    this.shown = { key, of: wanted, range: overview.range, picture: new VolumePicture(overview, wanted.volume.geometry) };
    this.style = undefined;
  }

  private remove(): void {
    if (this.shown === undefined) return;
    this.onPicture(undefined);
    this.shown.picture.dispose();
    this.shown = undefined;
  }

  private restyle(): void {
    const { shown, wanted } = this;
    if (shown === undefined || wanted === undefined) return;
    const style: VolumeStyle = { ...wanted.style, window: wanted.style.window ?? shown.range };
    if (isEqual(style, this.style)) return;
    this.style = style;
    shown.picture.style = style;
    this.onPicture(shown.picture);
  }
}
