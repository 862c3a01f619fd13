/** Probes the surface under the pointer: the scene finds the position on the surface, and the server returns the values there. */

import type { Probed, Question, Vec3 } from "../protocol/types";

/** A place of the page, `clientX` and `clientY`. */
export type Place = readonly [number, number];

/** A point of a surface, and the surface's number. */
export interface Found {
  readonly position: Vec3;
  readonly surface: number;
}

export interface ProberHandlers {
  /** The nearest point of a surface at a place of the page. */
  readonly pick: (place: Place) => Promise<Found | undefined>;
  readonly ask: (question: Question) => void;
  /** The values at the last place of the pointer; `undefined` if there is no surface there. */
  readonly onProbed: (probed: Probed | undefined) => void;
}

/** Between two places of a moving pointer: the scene renders for each of them. */
const INTERVAL_MS = 80;
/** A question that got no answer by then was dropped: an edit failed, a volume was opened. */
const GIVE_UP_MS = 3000;

export class Prober {
  /** Place of the pointer; only the latest one is probed. */
  private next: Place | undefined;
  /** Counts the visits of the pointer: an answer for an earlier visit is not shown. */
  private turn = 0;
  private isBusy = false;
  /** Clicked places without an answer yet. They take precedence over places that the pointer passes. */
  private clicked = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private waiting: ((probed: Probed | undefined) => void) | undefined;

  constructor(private readonly handlers: ProberHandlers) {}

  /** The pointer rests or moves over the picture. */
  hover(place: Place): void {
    this.next = place;
    if (!this.isBusy) void this.look();
  }

  /** The pointer left the picture, or the surface under it is about to change. */
  leave(): void {
    this.turn += 1;
    this.next = undefined;
    this.handlers.onProbed(undefined);
  }

  /** Finds the position on a surface at a place of the page. */
  locate(place: Place): Promise<Found | undefined> {
    return this.handlers.pick(place);
  }

  /** Probes a clicked place of the page. */
  async probe(place: Place): Promise<Probed | undefined> {
    this.clicked += 1;
    try {
      const found = await this.locate(place);
      return found && (await this.ask(found));
    } finally {
      this.clicked -= 1;
    }
  }

  /** The numbers of the parts at places of a surface, one after the other; `null` if there is none, or the server does not say. */
  async partsAt(places: readonly Vec3[], surface: number): Promise<readonly (number | null)[]> {
    this.clicked += 1;
    try {
      const numbers: (number | null)[] = [];
      for (const position of places) numbers.push((await this.ask({ position, surface }))?.nearest?.part ?? null);
      return numbers;
    } finally {
      this.clicked -= 1;
    }
  }

  /** Probes a place, which need not be on the surface. */
  async at(found: Found): Promise<Probed | undefined> {
    this.clicked += 1;
    try {
      return await this.ask(found);
    } finally {
      this.clicked -= 1;
    }
  }

  private ask({ position, surface }: Found): Promise<Probed | undefined> {
    // One question is under way at a time: the server answers the newest alone.
    this.waiting?.(undefined);
    return new Promise((answer) => {
      const done = (probed: Probed | undefined) => {
        clearTimeout(givesUp);
        if (this.waiting === done) this.waiting = undefined;
        answer(probed);
      };
      const givesUp = setTimeout(() => done(undefined), GIVE_UP_MS);
      this.waiting = done;
      this.handlers.ask({ type: "probe", surface, position: [...position] });
    });
  }

  /** Takes the server's answer. An answer to an earlier question than the last is ignored. */
  answered(probed: Probed): void {
    this.waiting?.(probed);
  }

  /** Probes the latest of the places that came meanwhile. */
  private async look(): Promise<void> {
    const { next, turn } = this;
    if (next === undefined) return;
    this.next = undefined;
    this.isBusy = true;
    try {
      const found = await this.locate(next);
      if (turn !== this.turn || this.clicked > 0) return;
      const probed = found && (await this.ask(found));
      if (turn === this.turn) this.handlers.onProbed(probed);
    } finally {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => {
        this.isBusy = false;
        void this.look();
      }, INTERVAL_MS);
    }
  }
}
