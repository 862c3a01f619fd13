/** A store whose events have short names, and a page that keeps a stream at it. */

import { StreamClient, type StreamClientHandlers } from "../src/net/streamClient";
import type { Edit, ServerMessage } from "../src/protocol/types";
import type { Look, Pose } from "../src/state/look";
import type { PageLayers } from "../src/state/page";
import { reduce, type StateEvent } from "../src/state/reduce";
import { canRedoIn, canUndoIn, FIRST_STATE, poseFor, viewerIn, wantedOf, type State } from "../src/state/state";
import { Store } from "../src/state/store";
import type { SurfaceStyle } from "../src/state/surfaceList";
import { NEW_SURFACE, type SurfaceState } from "../src/state/surfaceState";
import type { ViewerState } from "../src/state/viewer";

/** A state, with what is known in it among the fields. */
export type Known = ViewerState & { readonly state: State };

const knownIn = (state: State): Known => ({ ...viewerIn(state), state });

/** Before the server has said anything. */
export const NOTHING_KNOWN = knownIn(FIRST_STATE);

/** What is known of one surface alone. */
export const knownOfOne = (one: Partial<SurfaceState>): Known => ({ ...NOTHING_KNOWN, ...one, known: new Map([[0, { ...NEW_SURFACE, ...one }]]) });

export const run = (from: Known, ...events: StateEvent[]): Known => knownIn(events.reduce(reduce, from.state));

type Wish = Omit<NonNullable<State["wish"]>, "volume">;

export class ActingStore extends Store {
  /** Opens a volume as the server answers. Returns the pose that the camera shall have. */
  open(message: Extract<ServerMessage, { type: "opened" }>, wish?: Wish): Pose | undefined {
    const { volume, step } = message;
    const isOther = this.viewer.volume?.id !== volume.id;
    this.dispatch({ type: "open", target: { volume: volume.id, step }, wish: wish && { ...wish, volume: volume.id } });
    const pose = isOther ? poseFor(this.state, volume.id) : undefined;
    this.dispatch({ type: "message", message });
    return pose;
  }

  /** The open volume is left for another one. */
  leave(pose: Pose | undefined): void {
    const { target } = this.viewer;
    if (target !== undefined) this.dispatch({ type: "open", target, leaving: { pose } });
  }

  edit(edit: Edit, gesture?: string): void {
    this.dispatch({ type: "edit", edit, gesture });
  }

  changeLook(look: Partial<Look>): void {
    this.dispatch({ type: "look", look });
  }

  changeStyle(surface: number, style: Partial<SurfaceStyle>): void {
    this.dispatch({ type: "style", surface, style });
  }

  changePage(layers: Partial<PageLayers>): void {
    this.dispatch({ type: "page", layers });
  }

  goTo(step: number, gesture?: string): void {
    this.dispatch({ type: "step", step, gesture });
  }

  addSurface(iso: number): void {
    this.dispatch({ type: "add", iso });
  }

  removeSurface(surface: number): void {
    this.dispatch({ type: "remove", surface });
  }

  select(surface: number): void {
    this.dispatch({ type: "select", surface });
  }

  replace(wish: Omit<Wish, "pose">): void {
    this.dispatch({ type: "replace", wish });
  }

  endGesture(): void {
    this.dispatch({ type: "end-gesture" });
  }

  cancelGesture(name: string): void {
    this.dispatch({ type: "cancel-gesture", name });
  }

  undo(): void {
    this.dispatch({ type: "undo" });
  }

  redo(): void {
    this.dispatch({ type: "redo" });
  }

  get canUndo(): boolean {
    return canUndoIn(this.state);
  }

  get canRedo(): boolean {
    return canRedoIn(this.state);
  }
}

/** A store, and a client that keeps the server at it, as the page does. */
export class ActingPage {
  readonly store = new ActingStore();
  readonly client: StreamClient;

  constructor(url: string | ((volume: string | undefined) => string), handlers: Partial<StreamClientHandlers> = {}) {
    this.client = new StreamClient(url, {
      wanted: () => wantedOf(this.store.state),
      onState: () => undefined,
      onReset: () => undefined,
      onChunk: () => undefined,
      onBroken: (reason) => {
        throw new Error(reason);
      },
      onOnlyLooks: () => undefined,
      onEditSent: (surface) => this.store.dispatch({ type: "sent", surface, at: 0 }),
      ...handlers,
      onMessage: (message) => {
        if (message.type === "led") this.store.dispatch({ type: "open", target: { volume: message.volume, step: message.step } });
        this.store.dispatch({ type: "message", message });
        handlers.onMessage?.(message);
        if (message.type === "opened") this.client.follow();
      },
    });
  }

  open(volume: string, step: number): void {
    const isOther = this.store.viewer.volume?.id !== volume;
    this.store.dispatch({ type: "open", target: { volume, step }, leaving: isOther ? { pose: undefined } : undefined });
    this.client.open();
  }

  change(act: (store: ActingStore) => void): void {
    act(this.store);
    this.client.follow();
  }

  edit(edit: Edit): void {
    this.change((store) => store.edit(edit));
  }
}
