/** Two pictures side by side: before and after edits, the full surfaces and the decimated ones, or with importance and without. */

import type { SurfaceRenderer } from "../scene/renderer";
import type { Compared, Comparing } from "../state/comparing";
import type { Store } from "../state/store";
import { formatCount } from "../ui/format";

const NAMES = { edit: ["before", "now"], full: ["full", "decimated"], importance: ["with importance", "without"] } as const;

export class Comparison {
  /** What is said of the surface now; `undefined`: nothing. */
  private now: string | undefined;

  /** @param change changes what is compared */
  constructor(
    private readonly scene: SurfaceRenderer,
    private readonly store: Pick<Store, "state">,
    private readonly change: (comparing: Comparing | undefined) => void,
  ) {}

  /** Keeps what is shown now to compare it with edits or with the same budget without importance, or fetches the full surface to compare with. */
  start(kind: Compared): void {
    if (this.scene.regionCount === 0) return;
    this.end();
    if (kind === "full") this.change({ kind, isWaiting: true, kept: 0 });
    else this.keep(kind);
  }

  end(): void {
    if (this.store.state.comparing === undefined) return;
    this.now = undefined;
    this.change(undefined);
    this.scene.release();
  }

  /** Something may have come. `settled`: all that was asked for is on screen. */
  advance(settled: boolean): void {
    const { comparing } = this.store.state;
    if (comparing?.isWaiting === false) this.show(comparing);
    else if (comparing !== undefined && settled) this.keep(comparing.kind);
  }

  private keep(kind: Compared): void {
    const comparing = { kind, isWaiting: false, kept: this.shown };
    this.scene.keep();
    this.show(comparing);
    this.change(comparing);
  }

  private get shown(): number {
    return this.scene.levelTriangles.reduce((sum, n) => sum + n, 0);
  }

  /** Says what is on both sides; what it says already costs no frame. */
  private show({ kind, kept }: Comparing): void {
    const [before, after] = NAMES[kind];
    const now = `${after} · ${formatCount(this.shown)} triangles`;
    if (now === this.now) return;
    this.now = now;
    this.scene.swipe(this.scene.annotations.swipe.value ?? 0.5, { kept: `${before} · ${formatCount(kept)} triangles`, now });
  }
}
