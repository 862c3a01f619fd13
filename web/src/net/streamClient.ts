/**
 * Client of the stream: keeps the server at the volume, the step and the surfaces that are wanted. It reads them when it sends something, so it
 * holds only what it has sent. On a new connection it starts from what the server opens with. It sends at most 20 edits a second of each
 * surface, always including the last one.
 */

import { ASKED_CODINGS } from "../protocol/chunk";
import { parseServerMessage } from "../protocol/messages";
import { difference, hasBudget, isColorAlone, isNothing, withBudget } from "../protocol/view";
import type { Capabilities, ClientMessage, Edit, GroupMessage, Question, ServerMessage, StreamMessage, View, ViewCamera } from "../protocol/types";
import { isEqual } from "../protocol/equal";
import { Connection, type ConnectionState } from "./connection";
import { joining, leadingAgain, placeOf, type Joined, type Leading } from "./leading";
import { Throttle } from "./throttle";

/** 20 edits a second are smooth under a dragged slider; the server would merge more of them anyway. */
const EDIT_INTERVAL_MS = 50;

/** What the page wants from the server. */
interface Wanted {
  /** `undefined` until a volume was chosen. */
  readonly target: { readonly volume: string; readonly step: number } | undefined;
  /** The budget of the first counts for all that have one. */
  readonly surfaces: readonly { readonly number: number; readonly view: View }[];
}

export interface StreamClientHandlers {
  /** Read whenever something is to be sent. */
  readonly wanted: () => Wanted;
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
  /** Volume of the page's link, as long as none is wanted. */
  readonly linked?: () => string | undefined;
  /** Whether a proxy has several servers, and chooses one by the volume in the address. */
  readonly hasSeveralServers?: () => boolean;
}

export class StreamClient {
  private readonly connection: Connection;
  private readonly throttle: Throttle;
  /** The volume of the last `opened` of this connection. */
  private volume: string | undefined;
  /** Views of surfaces as the server has them, by their numbers: those that it opened with, and what was sent since. */
  private readonly sent = new Map<number, View>();
  /** Camera that was sent since the last `opened`; `undefined`: none. */
  private sentCamera: ViewCamera | null | undefined;
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
  /** Whether this connection leads the group that the page leads. */
  private isLeading = false;
  /** Volume in the address of this connection; null before the first one. */
  private addressed: string | undefined | null = null;

  /** @param address as a `Connection` takes it, for a volume */
  constructor(
    address: string | ((volume: string | undefined) => string | Promise<string>),
    private readonly handlers: StreamClientHandlers,
  ) {
    this.throttle = new Throttle(EDIT_INTERVAL_MS, () => this.flush());
    const open = () => {
      const place = (this.addressed = this.place);
      return typeof address === "string" ? address : address(place);
    };
    this.connection = new Connection(open, {
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
        if (state !== "connected") this.opened = this.isLeading = false;
        this.handlers.onState(state, reason);
      },
    });
  }

  /** Number of text frames sent, without questions and cameras, which change no values. */
  get framesSent(): number {
    return this.connection.framesSent - this.asked;
  }

  /** Whether edits wait to be sent. */
  get dirty(): boolean {
    return !this.isLed && this.edits().length > 0;
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

  /** Volume by which a proxy of several servers chooses the server of this page. In a group, it is that of the leader. */
  get place(): string | undefined {
    return (this.leading ?? this.joined)?.via ?? this.handlers.wanted().target?.volume ?? this.handlers.linked?.();
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
   * Opens the wanted volume at the wanted step. Another step of the open volume keeps its surfaces, and, if the server supports it, their
   * meshes; another volume starts with its own view.
   */
  open(): void {
    const { target } = this.handlers.wanted();
    if (this.isLed || target === undefined) return;
    if (this.opened && this.canStep && this.volume === target.volume) {
      this.flush();
      this.send({ type: "step", step: target.step });
      return;
    }
    this.throttle.cancel();
    if (!this.moved()) this.sendOpen();
  }

  /** Connects to the server that a proxy has for what is wanted, if that is another one; `open` and the edits follow. Returns whether it does. */
  private moved(): boolean {
    if (this.addressed === null || this.handlers.hasSeveralServers?.() !== true || this.place === this.addressed) return false;
    this.opened = false;
    this.connection.reopen();
    return true;
  }

  /** Other surfaces or values are wanted: sends what differs, soon. */
  follow(): void {
    if (this.isLed) return this.adopt();
    this.removeOthers();
    if (!this.opened) return;
    for (const { number, view } of this.handlers.wanted().surfaces) {
      const before = this.sent.get(number);
      if (before !== undefined && isColorAlone(difference(before, view), before)) this.sent.set(number, view);
    }
    if (this.edits().length > 0) this.throttle.call();
  }

  /** Whether the server has to be told this camera. */
  isNewCamera(camera: ViewCamera | null): boolean {
    return this.opened && !isEqual(camera, this.sentCamera);
  }

  /** The camera of the page; null: that of the member in control. Returns whether it was sent: the server has to be told what is new to it. */
  sendCamera(camera: ViewCamera | null): boolean {
    if (!this.isNewCamera(camera) || !this.send({ type: "camera", camera })) return false;
    this.asked += 1;
    this.sentCamera = camera;
    return true;
  }

  /** The first prefix of a generation is on screen. */
  acknowledge(generation: number): void {
    if (this.opened) this.send({ type: "drawn", generation });
  }

  /** Asks about the surface on screen; the answer is a message. Not repeated on a new connection. */
  ask(question: Question): void {
    if (this.opened && this.send(question)) this.asked += 1;
  }

  /** Follows a group from now on, with a name for its leader. `via`: the volume by which its members meet. */
  join(group: string, name: string | undefined, via = this.addressed ?? undefined): void {
    this.leading = undefined;
    this.joined = { group, ...(name === undefined ? {} : { name }), ...placeOf(via) };
    this.isLed = true;
    this.throttle.cancel();
    this.adopt();
    if (!this.moved()) this.send(joining(this.joined));
  }

  /** Sends a message about the group. */
  say(message: GroupMessage): void {
    if (message.type === "leave") [this.joined, this.leading, this.isLeading] = [undefined, undefined, false];
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
    const { target } = this.handlers.wanted();
    if (target !== undefined) this.send({ type: "open", volume: target.volume, step: target.step, codings: [...ASKED_CODINGS] });
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
    const { target } = this.handlers.wanted();
    if (message.type === "opened") {
      // The reply to an earlier `open`.
      if (message.volume.id !== target?.volume || message.step !== target.step) return;
      this.handlers.onReset();
      this.startWith(message);
      return;
    }
    // The replies to earlier steps.
    if ((message.type === "stepped" || message.type === "described") && message.step !== target?.step) return;
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
    if (message.type !== "led" && message.type !== "posed") return false;
    // Another volume will be open.
    if (message.type === "led" && message.volume !== this.volume) this.opened = false;
    this.handlers.onMessage(message);
    return true;
  }

  private receiveGroup({ key, ...message }: Extract<ServerMessage, { type: "group" }>): true {
    this.isLed = message.control !== message.you;
    if (key !== undefined) [this.leading, this.joined, this.isLeading] = [{ group: message.group, key, ...placeOf(this.addressed ?? undefined) }, undefined, true];
    this.handlers.onMessage(message);
    return true;
  }

  /** The page has left its group; the shown surfaces stay. */
  private parted(message: StreamMessage): true {
    [this.joined, this.leading, this.isLed, this.isLeading] = [undefined, undefined, false, false];
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

  /** The server starts from its own values; what is wanted differs from them, if there is a link or earlier work. */
  private startWith(message: Extract<ServerMessage, { type: "opened" }>): void {
    // An older server, without a message for time steps, does not send this capability.
    this.canStep = (message.capabilities as Partial<Capabilities>).steps === true;
    this.volume = message.volume.id;
    this.sentCamera = undefined;
    this.sent.clear();
    if (this.isLed) {
      this.sent.set(0, message.edit);
      [this.opened, this.isShown] = [true, true];
      this.handlers.onMessage(message);
      return;
    }
    // The page takes up the volume: what it wants of it is part of the first edits.
    this.handlers.onMessage(message);
    this.sent.set(0, message.edit);
    [this.opened, this.isShown] = [true, false];
    this.removeOthers();
    const edits = new Map(this.edits([...this.handlers.wanted().surfaces].sort((a, b) => a.number - b.number)));
    // An edit without values has the first surface made.
    if (this.sent.has(0) && !edits.has(0)) this.sendEdit(0, {});
    for (const [number, edit] of edits) this.sendEdit(number, edit);
    // Only now, as the page has restored its earlier state. Who leads on this connection already would end the group by that.
    if (!this.isLeading) this.leadAgain();
  }

  /** Another member decides: the server has what is shown. */
  private adopt(): void {
    this.sent.clear();
    for (const { number, view } of this.handlers.wanted().surfaces) this.sent.set(number, view);
  }

  /** What the server has to be told of surfaces: all of a new one. */
  private edits(surfaces = this.handlers.wanted().surfaces): readonly (readonly [number, Edit])[] {
    const now = new Map(this.sent);
    const edits: (readonly [number, Edit])[] = [];
    for (const { number, view } of surfaces) {
      const before = now.get(number);
      const edit = before === undefined ? view : difference(before, view);
      if (isNothing(edit) || isColorAlone(edit, before)) continue;
      edits.push([number, edit]);
      take(now, number, edit);
    }
    return edits;
  }

  private flush(): void {
    if (!this.opened || this.isLed) return;
    for (const [number, edit] of this.edits()) this.sendEdit(number, edit);
  }

  private removeOthers(): void {
    const { surfaces } = this.handlers.wanted();
    for (const number of [...this.sent.keys()]) {
      if (surfaces.some((surface) => surface.number === number)) continue;
      this.sent.delete(number);
      // A server that does not know it says nothing of it.
      if (!this.opened || !this.send({ type: "remove", surface: number })) this.handlers.onMessage({ type: "removed", surface: number });
    }
  }

  private sendEdit(surface: number, edit: Edit): void {
    // Without a number, the edit is of surface 0.
    const of = surface === 0 ? {} : { surface };
    if (!this.send({ type: "edit", ...of, ...edit })) return;
    take(this.sent, surface, edit);
    this.handlers.onEditSent(surface);
  }

  private send(message: ClientMessage): boolean {
    return this.connection.send(JSON.stringify(message));
  }
}

/** Takes an edit into the views that the server has. A new surface has all values; a budget is one for all surfaces that have one. */
function take(views: Map<number, View>, surface: number, edit: Edit): void {
  const view = { ...views.get(surface), ...edit } as View;
  if (hasBudget(edit)) for (const [number, other] of views) views.set(number, withBudget(other, edit));
  views.set(surface, view);
}
