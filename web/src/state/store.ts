/** The owner of the page's state: all else reads it and dispatches events. */

import type { View } from "../protocol/types";
import type { Look } from "./look";
import type { PageLayers } from "./page";
import { reduce, type StateEvent } from "./reduce";
import { FIRST_STATE, surfaceOf, viewerIn, workOf, type State, type Work } from "./state";
import type { Surface, SurfaceList } from "./surfaceList";
import type { ViewerState } from "./viewer";

export class Store {
  private value = FIRST_STATE;

  /** @param isEmbedded the page is a picture in another one, without cards */
  constructor(readonly isEmbedded = false) {}

  get state(): State {
    return this.value;
  }

  dispatch(event: StateEvent): void {
    this.value = reduce(this.value, event);
  }

  get viewer(): ViewerState {
    return viewerIn(this.value);
  }

  get work(): Work {
    return workOf(this.value);
  }

  /** None until a volume is open. */
  get surfaces(): SurfaceList {
    return this.work.surfaces;
  }

  /** The surface that edits are of. */
  get surface(): Surface | undefined {
    return surfaceOf(this.value);
  }

  /** Of the selected surface. */
  get view(): View | undefined {
    return this.surface?.view;
  }

  /** The time step that is wanted. */
  get step(): number {
    return this.work.step;
  }

  get look(): Look {
    return this.work.look;
  }

  get page(): PageLayers {
    return this.value.page;
  }
}
