/** Two pictures side by side: before and after edits, the full surfaces and the decimated ones, or with importance and without. */

import type { Edit, View } from "../protocol/types";
import type { SurfaceRenderer } from "../scene/renderer";
import { complete } from "../state/view";
import { formatCount } from "../ui/format";
import type { Compared } from "../ui/actions";

export interface ComparisonHandlers {
  /** `wanted` says otherwise than before. */
  readonly ask: () => void;
  readonly onChange: (state: Compared | "waiting" | undefined) => void;
}

const FULL: Edit = complete({ triangles: { share: 1 } });
const NAMES = { edit: ["before", "now"], full: ["full", "decimated"], importance: ["with importance", "without"] } as const;

/** A view of as many triangles in which everything is as important. */
function withoutImportance(view: View, triangles: number): View {
  const points = view.transferFunction.points.map((point) => ({ ...point, importance: 0 }));
  return { ...view, ...complete({ triangles }), transferFunction: { points }, interest: [] };
}


export class Comparison {
  private kind: Compared | undefined;
  private waiting = false;
  /** Triangles of the kept picture. */
  private kept = 0;
  private texts = "";

  constructor(
    private readonly scene: SurfaceRenderer,
    private readonly handlers: ComparisonHandlers,
  ) {}

  /** Keeps what is shown now to compare it with edits or with the same budget without importance, or fetches the full surface to compare with. */
  start(kind: Compared): void {
    if (this.scene.regionCount === 0) return;
    this.end();
    this.kind = kind;
    if (kind !== "full") {
      this.keep();
      return kind === "importance" ? this.handlers.ask() : undefined;
    }
    this.waiting = true;
    this.handlers.onChange("waiting");
    this.handlers.ask();
  }

  /** What the server is asked for in place of values in force, which the user sees: the full surface while it is fetched, or none of the importance. */
  wanted(view: View): View {
    if (this.kind === "importance") return withoutImportance(view, this.kept);
    return this.waiting ? { ...view, ...FULL } : view;
  }

  end(): void {
    if (this.kind === undefined) return;
    const isReplaced = this.waiting || this.kind === "importance";
    this.kind = undefined;
    this.texts = "";
    this.waiting = false;
    if (isReplaced) this.handlers.ask();
    this.scene.release();
    this.handlers.onChange(undefined);
  }

  /** Something may have come. `settled`: all that was asked for is on screen. */
  advance(settled: boolean): void {
    if (this.waiting && settled) {
      this.waiting = false;
      this.keep();
      this.handlers.ask();
    } else if (this.kind !== undefined && !this.waiting) this.show();
  }

  private keep(): void {
    this.kept = this.shown;
    this.scene.keep();
    this.show();
    this.handlers.onChange(this.kind);
  }

  private get shown(): number {
    return this.scene.levelTriangles.reduce((sum, n) => sum + n, 0);
  }

  /** Says what is on both sides; what it says already costs no frame. */
  private show(): void {
    if (this.kind === undefined) return;
    const [before, after] = NAMES[this.kind];
    const texts = { kept: `${before} · ${formatCount(this.kept)} triangles`, now: `${after} · ${formatCount(this.shown)} triangles` };
    const text = JSON.stringify(texts);
    if (text === this.texts) return;
    this.texts = text;
    this.scene.swipe(this.scene.annotations.swipe.value ?? 0.5, texts);
  }
}
