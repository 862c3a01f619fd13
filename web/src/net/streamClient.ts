/**
 * Client of the stream: opens a volume at a step and edits the views of its surfaces. Repeats both on a new connection, merges edits, and sends at
 * most 20 a second of each surface, always including the last one.
 */

import { hasBudget, withBudget } from "../protocol/budget";
import { ASKED_CODINGS } from "../protocol/chunk";
import { parseServerMessage } from "../protocol/messages";
import type { Capabilities, ClientMessage, Edit, GroupMessage, Question, ServerMessage, StreamMessage, View } from "../protocol/types";
import { Connection, type ConnectionState } from "./connection";
import { joining, leadingAgain, type Joined, type Leading } from "./leading";
import { Throttle } from "./throttle";

/** 20 edits a second are smooth under a dragged slider; the server would merge more of them anyway. */
const EDIT_INTERVAL_MS = 50;

export interface StreamClientHandlers {
  /** `reason`: why the connection was closed, if that is known. */
  readonly onState: (state: ConnectionState, reason: string | undefined) => void;
  /** The server assumes that this client holds nothing: the next prefix is a whole surface. */
  readonly onReset: () => void;
  readonly onMessage: (message: StreamMessage) => void;
  readonly onChunk: (frame: ArrayBuffer) => void;
  /** A frame violated the protocol. The client reconnects by itself. */
  readonly onBroken: (reason: string) => void;
  /** The user may only look: an edit was refused. Not reported as an error, because the next surface would hide that. */
  readonly onOnlyLooks: (reason: string) => void;
  /** An edit of a surface was sent. */
  readonly onEditSent: (surface: number) => void;
}

/** The user's state of a surface. */
interface WantedSurface {
  /** Values in force, with edits that were not sent yet. */
  view: View;
  /** Edits that were not sent yet, merged; `undefined`: there are none. */
  unsent: Edit | undefined;
  /** Whether the server knows it: an edit of it was sent on this connection. */
  isMade: boolean;
}

export class StreamClient {
  private readonly connection: Connection;
  private readonly throttle: Throttle;
  /** The volume and step to open, once known. */
  private target: { readonly volume: string; readonly step: number } | undefined;
  /** By their numbers; none until the first `opened` of the target. */
  private readonly surfaces = new Map<number, WantedSurface>();
  /** The view that the volume opens with: the view of a new surface is derived from it. */
  private opening: View | undefined;
  /** The server has answered the last `open`. */
  private opened = false;
  /** The server goes to another step of the open volume without opening it again. */
  private canStep = false;
  /** Whether a prefix was committed since the last `opened`, or is coming for a user who may only look. */
  private isShown = false;
  private asked = 0;
  /** The group to follow, also on a new connection. */
  private joined: Joined | undefined;
  /** The group that this page leads, with the key to resume it on a new connection. */
  private leading: Leading | undefined;
  /** Whether another member of the group has control, or will get it: then this page shows that member's view and requests nothing itself. */
  private isLed = false;

  /** @param address as a `Connection` takes it */
  constructor(
    address: string | (() => string | Promise<string>),
    private readonly handlers: StreamClientHandlers,
  ) {
    this.throttle = new Throttle(EDIT_INTERVAL_MS, () => this.flush());
    this.connection = new Connection(typeof address === "string" ? () => address : address, {
      onOpen: () => {
        if (this.send({ type: "heartbeat" })) this.asked += 1;
        this.sendOpen();
      },
      onText: (text) => this.receive(text),
      // Chunks that arrive between an `open` and its `opened` belong to the previous volume.
      onBinary: (frame) => {
        if (this.opened) this.handlers.onChunk(frame);
      },
      onState: (state, reason) => {
        if (state !== "connected") this.opened = false;
        this.handlers.onState(state, reason);
      },
    });
  }

  /** Number of text frames sent, without questions, which change nothing. */
  get framesSent(): number {
    return this.connection.framesSent - this.asked;
  }

  /** Whether edits wait to be sent. */
  get dirty(): boolean {
    return [...this.surfaces.values()].some(({ unsent }) => unsent !== undefined);
  }

  /** Numbers of the surfaces. */
  get numbers(): readonly number[] {
    return [...this.surfaces.keys()];
  }

  /** Whether the server answered the last `open`. */
  get ready(): boolean {
    return this.opened;
  }

  /** Whether the view of another member is shown. */
  get following(): boolean {
    return this.isLed;
  }

  /** The group that this page leads. */
  get leads(): Leading | undefined {
    return this.leading;
  }

  /** After a reload of the page, continues to lead the group that it led before, as soon as a volume is open. */
  leadOn(leading: Leading): void {
    this.leading = leading;
  }

  start(): void {
    this.connection.start();
  }

  stop(): void {
    this.throttle.cancel();
    this.connection.stop();
  }

  retryNow(): void {
    this.connection.retryNow();
  }

  /** Reconnects. If a pause before the next attempt is running, it ends at once. */
  reconnect(): void {
    if (this.connection.isWaiting) this.retryNow();
    else this.restart();
  }

  /** Reconnects and repeats `open` and the edits. */
  restart(): void {
    this.opened = false;
    this.connection.restart();
  }

  /**
   * Opens a volume at a time step. Another step of the open volume keeps the edits, and, if the server supports it, the meshes of its
   * surfaces; another volume starts with its own view.
   */
  open(volume: string, step: number): void {
    if (this.isLed) return;
    if (this.opened && this.canStep && this.target?.volume === volume) {
      this.target = { volume, step };
      this.flush();
      this.send({ type: "step", step });
      return;
    }
    if (this.target?.volume !== volume) {
      this.surfaces.clear();
      this.opening = undefined;
    }
    this.target = { volume, step };
    for (const surface of this.surfaces.values()) surface.unsent = undefined;
    this.throttle.cancel();
    this.sendOpen();
  }

  /**
   * Merges an edit of a surface; it is sent soon. The first edit of a surface makes it. `false` before `opened`: there is no view to
   * edit yet.
   */
  edit(edit: Edit, surface = 0): boolean {
    const wanted = this.surfaces.get(surface) ?? this.added(surface);
    if (wanted === undefined) return false;
    wanted.view = { ...wanted.view, ...edit };
    wanted.unsent = this.isLed ? undefined : { ...wanted.unsent, ...edit };
    if (this.isLed) return true;
    if (edit.triangles !== undefined || edit.bytes !== undefined) this.shareBudget(wanted.view);
    if (this.opened) this.throttle.call();
    return true;
  }

  /** Keeps an edit that changes nothing on the server; it is sent with the others on a new connection. */
  remember(edit: Edit, surface = 0): void {
    const wanted = this.surfaces.get(surface);
    if (wanted !== undefined) wanted.view = { ...wanted.view, ...edit };
  }

  /**
   * Removes a surface. Returns whether a request was sent: then its meshes are removed with the answer `removed`; otherwise the server
   * does not know the surface and does not answer.
   */
  remove(surface: number): boolean {
    const isMade = this.surfaces.get(surface)?.isMade === true;
    this.surfaces.delete(surface);
    if (this.isLed) return true;
    return isMade && this.opened && this.send({ type: "remove", surface });
  }

  /** The view of a surface, with edits that were not sent yet. */
  view(surface = 0): View | undefined {
    return this.surfaces.get(surface)?.view;
  }

  /** The first prefix of a generation is on screen. */
  acknowledge(generation: number): void {
    if (this.opened) this.send({ type: "drawn", generation });
  }

  /** Asks about the surface on screen; the answer is a message. Not repeated on a new connection. */
  ask(question: Question): void {
    if (this.opened && this.send(question)) this.asked += 1;
  }

  /** Follows a group from now on, with a name for its leader. */
  join(group: string, name: string | undefined): void {
    this.leading = undefined;
    this.joined = { group, ...(name === undefined ? {} : { name }) };
    this.isLed = true;
    this.throttle.cancel();
    for (const surface of this.surfaces.values()) surface.unsent = undefined;
    this.send(joining(this.joined));
  }

  /** Sends a message about the group. */
  say(message: GroupMessage): void {
    if (message.type === "leave") [this.joined, this.leading] = [undefined, undefined];
    this.send(message);
  }

  private sendOpen(): void {
    this.opened = false;
    if (this.joined !== undefined) {
      this.isLed = true;
      this.send(joining(this.joined));
      return;
    }
    // Another member decides which volume is opened.
    if (this.isLed && this.leadAgain()) return;
    if (this.target !== undefined) this.send({ type: "open", ...this.target, codings: [...ASKED_CODINGS] });
  }

  /** If this page leads a group, resumes it on this connection. Returns whether it does. */
  private leadAgain(): boolean {
    return this.leading !== undefined && this.send(leadingAgain(this.leading));
  }

  private receive(text: string): void {
    let message: ServerMessage;
    try {
      message = parseServerMessage(text);
    } catch (error) {
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
      this.restart();
      return;
    }
    if (message.type === "heartbeat") return this.connection.expectWithin(message.seconds);
    if (this.receiveOfGroup(message)) return;
    if (message.type === "opened") {
      // The reply to an earlier `open`.
      if (message.volume.id !== this.target?.volume || message.step !== this.target.step) return;
      this.handlers.onReset();
      this.repeat(message);
      return;
    }
    // The replies to earlier steps.
    if ((message.type === "stepped" || message.type === "described") && message.step !== this.target?.step) return;
    // Messages of a generation that arrive between an `open` and its `opened` belong to the previous volume.
    if (message.type === "committed") this.isShown = true;
    if (message.type === "error" && message.code === "forbidden") {
      this.handlers.onOnlyLooks(message.message);
      if (this.look()) return;
    }
    if (this.opened || message.type === "error" || message.type === "opening") this.handlers.onMessage(message);
  }

  /** Returns whether the message is about a group. From then on, this page expects the other member's view. */
  private receiveOfGroup(message: StreamMessage): boolean {
    if (message.type === "left") return this.parted(message);
    if (message.type === "error") return (message.code === "unknown-group" || message.code === "group-full") && this.parted(message);
    if (message.type === "group") return this.receiveGroup(message);
    if (message.type === "led") this.expect(message.volume, message.step);
    else if (message.type !== "posed") return false;
    this.handlers.onMessage(message);
    return true;
  }

  private receiveGroup({ key, ...message }: Extract<ServerMessage, { type: "group" }>): true {
    this.isLed = message.control !== message.you;
    if (key !== undefined) [this.leading, this.joined] = [{ group: message.group, key }, undefined];
    this.handlers.onMessage(message);
    return true;
  }

  /** Another member has opened this volume. */
  private expect(volume: string, step: number): void {
    if (this.target?.volume !== volume) {
      this.opened = false;
      this.surfaces.clear();
    }
    this.target = { volume, step };
  }

  /** The page has left its group; the shown surfaces stay. */
  private parted(message: StreamMessage): true {
    [this.joined, this.leading, this.isLed] = [undefined, undefined, false];
    this.handlers.onMessage(message);
    if (!this.opened) this.sendOpen();
    return true;
  }

  /** Shows the volume's opening view if the user may not edit, even if a link has other values: an edit without values is not refused. */
  private look(): boolean {
    if (!this.opened || this.isShown) return false;
    this.isShown = true;
    this.sendEdit(0, {});
    return true;
  }

  /** The server starts from its own values; the user's replace them, if there are any. */
  private repeat(message: Extract<ServerMessage, { type: "opened" }>): void {
    this.opening = message.edit;
    // An older server, without a message for time steps, does not send this capability.
    this.canStep = (message.capabilities as Partial<Capabilities>).steps === true;
    if (this.isLed) return this.adopt(message);
    const before = this.surfaces.get(0)?.view ?? {};
    const view = { ...message.edit, ...before };
    // The server has surface 0 alone. If it was removed, the remaining surfaces are the user's.
    for (const [surface, wanted] of this.surfaces) wanted.isMade = surface === 0;
    if (this.surfaces.size === 0 || this.surfaces.has(0)) this.surfaces.set(0, { view, unsent: undefined, isMade: true });
    // Edits that the page makes as soon as it knows the volume (a link's values) are part of the first edits.
    this.handlers.onMessage({ ...message, edit: view });
    this.opened = true;
    this.isShown = false;
    if (!this.surfaces.has(0)) this.send({ type: "remove", surface: 0 });
    for (const [surface, wanted] of this.surfaces) {
      const edit = surface === 0 && wanted.isMade ? this.changed(message.edit, { ...before, ...wanted.unsent }) : wanted.view;
      wanted.unsent = undefined;
      this.sendEdit(surface, edit);
    }
    // Only now, as the page has restored its earlier state.
    this.leadAgain();
  }

  /** Returns an empty edit if all values are those that the volume opens with: a user who may only look is refused any other edit. */
  private changed(opening: View, edit: Edit): Edit {
    const names = Object.keys(edit) as (keyof Edit)[];
    return names.every((name) => JSON.stringify(edit[name]) === JSON.stringify(opening[name])) ? {} : edit;
  }

  /** Another member has opened it; its surfaces follow. */
  private adopt(message: Extract<ServerMessage, { type: "opened" }>): void {
    this.surfaces.clear();
    this.surfaces.set(0, { view: message.edit, unsent: undefined, isMade: true });
    [this.opened, this.isShown] = [true, true];
    this.handlers.onMessage(message);
  }

  /** A new surface begins as the volume opens, with the budget of the others. */
  private added(surface: number): WantedSurface | undefined {
    if (this.opening === undefined || (surface === 0 && this.surfaces.size === 0)) return undefined;
    const budget = [...this.surfaces.values()].find(({ view }) => hasBudget(view))?.view;
    const view =
      budget === undefined
        ? this.opening
        : { ...this.opening, beta: undefined, triangles: budget.triangles, bytes: budget.bytes };
    const wanted = { view, unsent: {}, isMade: false };
    this.surfaces.set(surface, wanted);
    return wanted;
  }

  /** The budget is one for all surfaces that have one. */
  private shareBudget({ triangles, bytes }: View): void {
    for (const other of this.surfaces.values()) other.view = withBudget(other.view, { triangles, bytes });
  }

  private flush(): void {
    if (!this.opened) return;
    for (const [surface, wanted] of this.surfaces) {
      const edit = wanted.unsent;
      wanted.unsent = undefined;
      if (edit !== undefined) this.sendEdit(surface, edit);
    }
  }

  private sendEdit(surface: number, edit: Edit): void {
    // Without a number, the edit is of surface 0.
    const of = surface === 0 ? {} : { surface };
    if (!this.send({ type: "edit", ...of, ...edit })) return;
    const wanted = this.surfaces.get(surface);
    if (wanted !== undefined) wanted.isMade = true;
    this.handlers.onEditSent(surface);
  }

  private send(message: ClientMessage): boolean {
    return this.connection.send(JSON.stringify(message));
  }
}
