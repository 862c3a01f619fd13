/**
 * Gets the samples of the three slices through the crosshair. Of each there is one request on its way; of the places that the crosshair passes meanwhile the
 * last one counts, and a request for a former one is aborted if it takes long. Samples of the latest slices are kept.
 */

import { fetchSlice, type Plane, type PlaneRequest } from "../net/slices";
import type { Vec3, VolumeInfo } from "../protocol/types";
import { crosshairOf, fieldsOf, pointed, type LoadedSlice, type SliceState, type Slicing } from "../state/slicing";
import type { Store } from "../state/store";
import { indexAt } from "../world/places";

/** The slices to show. */
export interface SlicesWanted {
  readonly volume: VolumeInfo;
  readonly step: number;
  readonly fields: readonly string[];
  readonly at: Vec3;
}

/** What the store says is to be shown beside the picture; `undefined`: nothing. */
export function slicesWanted({ isEmbedded, page: { slicing }, surfaces, view, viewer: { target, volume } }: Store): SlicesWanted | undefined {
  if (slicing.layout === "picture" || isEmbedded || view === undefined || volume === undefined || target?.volume !== volume.id) return undefined;
  return { volume, step: target.step, fields: fieldsOf(slicing, view.field, surfaces), at: crosshairOf(slicing, volume.geometry.dims) };
}

/** The slices with their crosshair at a place of the world. */
export function slicingAt({ page: { slicing }, viewer: { volume } }: Store, position: Vec3): Slicing {
  return volume === undefined ? slicing : pointed(slicing, volume.geometry.dims, indexAt(volume.geometry, position));
}

/** Between two requests for the slices across an axis. */
const INTERVAL_MS = 30;
/** Longest time for which a request may go on when its slice is no longer wanted: the slice is shown while the crosshair moves on. */
const SUPERSEDED_MS = 500;
/** A server that is busy is asked once more. */
const AGAIN_MS = 500;
const KEPT_BYTES = 96 << 20;

type Get = (base: URL, request: PlaneRequest, signal: AbortSignal) => Promise<Plane>;

/** Planes by what they are of, the latest last. */
class PlaneCache {
  private readonly planes = new Map<string, Plane>();
  private bytes = 0;

  get(key: string): Plane | undefined {
    const plane = this.planes.get(key);
    if (plane === undefined) return undefined;
    this.planes.delete(key);
    this.planes.set(key, plane);
    return plane;
  }

  add(key: string, plane: Plane): void {
    this.planes.set(key, plane);
    this.bytes += plane.samples.byteLength;
    for (const [oldest, { samples }] of this.planes) {
      if (this.bytes <= KEPT_BYTES || this.planes.size === 1) return;
      this.planes.delete(oldest);
      this.bytes -= samples.byteLength;
    }
  }

  clear(): void {
    this.planes.clear();
    this.bytes = 0;
  }
}

/** A slice that was asked for: samples of some fields at an index. */
interface Wanted {
  readonly key: string;
  /** What all but the index decides. */
  readonly source: string;
  readonly volume: string;
  readonly index: number;
  /** By the names of fields. */
  readonly requests: ReadonlyMap<string, PlaneRequest>;
}

const NAMES = ["x", "y", "z"] as const;
const keyOf = (request: PlaneRequest) => JSON.stringify(request);

function wantedOf({ volume, step, fields, at }: SlicesWanted, axis: 0 | 1 | 2): Wanted {
  const index = at[axis];
  const requests = new Map(fields.map((field) => [field, { volume: volume.id, step, field, axis: NAMES[axis], index }] as const));
  const source = JSON.stringify([volume.id, step, fields]);
  return { key: `${source} ${index}`, source, volume: volume.id, index, requests };
}

/** The slices across one axis. */
class AxisLoader {
  private wanted: Wanted | undefined;
  private flight: { readonly of: Wanted; readonly abort: AbortController; readonly startedAt: number } | undefined;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private lastStart = -Infinity;
  private failures = 0;
  private shown: (LoadedSlice & { readonly of: Wanted }) | undefined;
  private problem: string | undefined;

  constructor(
    private readonly cache: PlaneCache,
    private readonly get: (request: PlaneRequest, signal: AbortSignal) => Promise<Plane>,
    private readonly onChange: () => void,
  ) {}

  get state(): SliceState {
    return { loaded: this.shown, isCurrent: this.shown?.of.key === this.wanted?.key, problem: this.problem };
  }

  want(wanted: Wanted | undefined): void {
    if (wanted?.key === this.wanted?.key) return;
    // Another volume's slices would lie elsewhere.
    if (wanted?.volume !== this.wanted?.volume) this.shown = undefined;
    this.wanted = wanted;
    this.begin();
  }

  /** Requests again what is missing, even if the connection was cut and an answer will not come. */
  retry(): void {
    if (this.flight !== undefined) this.flight.abort.abort();
    else if (!this.state.isCurrent) this.begin();
  }

  private begin(): void {
    [this.failures, this.problem] = [0, undefined];
    this.advance();
  }

  /** Shows the wanted slices if they are cached; otherwise requests them as soon as a request may begin. */
  private advance(): void {
    const { wanted, flight } = this;
    clearTimeout(this.timer);
    const kept = wanted && this.kept(wanted);
    if (wanted === undefined || kept !== undefined) {
      flight?.abort.abort();
      if (kept !== undefined) this.shown = kept;
      return;
    }
    const now = performance.now();
    if (flight === undefined) return this.soon(this.lastStart + INTERVAL_MS - now, () => void this.load(wanted));
    if (flight.of.key === wanted.key) return;
    if (flight.of.source !== wanted.source) flight.abort.abort();
    else this.soon(flight.startedAt + SUPERSEDED_MS - now, () => flight.abort.abort());
  }

  private soon(ms: number, act: () => void): void {
    if (ms <= 0) act();
    else this.timer = setTimeout(act, ms);
  }

  private kept(wanted: Wanted): (LoadedSlice & { readonly of: Wanted }) | undefined {
    const planes = new Map<string, Plane>();
    for (const [field, request] of wanted.requests) {
      const plane = this.cache.get(keyOf(request));
      if (plane === undefined) return undefined;
      planes.set(field, plane);
    }
    return { index: wanted.index, planes, of: wanted };
  }

  private async load(wanted: Wanted): Promise<void> {
    const abort = new AbortController();
    this.lastStart = performance.now();
    this.flight = { of: wanted, abort, startedAt: this.lastStart };
    let fault: unknown;
    try {
      const planes = new Map<string, Plane>();
      // One after the other: a server answers few at a time.
      for (const [field, request] of wanted.requests) {
        const kept = this.cache.get(keyOf(request));
        const plane = kept ?? (await this.get(request, abort.signal));
        if (kept === undefined) this.cache.add(keyOf(request), plane);
        planes.set(field, plane);
      }
      if (wanted.source === this.wanted?.source) this.shown = { index: wanted.index, planes, of: wanted };
    } catch (error) {
      fault = error;
    }
    this.flight = undefined;
    if (fault !== undefined && !abort.signal.aborted && wanted.key === this.wanted?.key) this.failed(fault);
    else this.advance();
    this.onChange();
  }

  private failed(fault: unknown): void {
    this.failures += 1;
    if (this.failures < 2) return this.soon(AGAIN_MS, () => this.advance());
    this.problem = fault instanceof Error ? fault.message : String(fault);
  }
}

export class SlicePlanes {
  private readonly cache = new PlaneCache();
  private readonly axes: readonly AxisLoader[];
  private wasConnected = false;
  private told: readonly SliceState[] = [];

  constructor(
    private readonly onSlices: (slices: readonly SliceState[]) => void,
    base: URL,
    get: Get = fetchSlice,
  ) {
    const tell = () => this.tell();
    this.axes = NAMES.map(() => new AxisLoader(this.cache, (request, signal) => get(base, request, signal), tell));
  }

  /** `undefined`: no slices are shown. Over another connection the server may be another one. */
  show(wanted: SlicesWanted | undefined, isConnected: boolean): void {
    const isBack = isConnected && !this.wasConnected;
    this.wasConnected = isConnected;
    if (isBack || wanted === undefined) this.cache.clear();
    if (isBack) for (const loader of this.axes) loader.retry();
    this.axes.forEach((loader, axis) => loader.want(wanted && wantedOf(wanted, axis as 0 | 1 | 2)));
    this.tell();
  }

  /** After a problem. */
  retry(): void {
    for (const loader of this.axes) loader.retry();
    this.tell();
  }

  private tell(): void {
    const now = this.axes.map(({ state }) => state);
    if (now.length === this.told.length && now.every((state, axis) => isSame(state, this.told[axis]))) return;
    this.told = now;
    this.onSlices(now);
  }
}

function isSame(a: SliceState, b: SliceState | undefined): boolean {
  return a.loaded === b?.loaded && a.isCurrent === b?.isCurrent && a.problem === b.problem;
}
