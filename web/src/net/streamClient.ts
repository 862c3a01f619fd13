/**
 * What the user wants from the server: a volume, a step and an edit. Keeps it over reconnects, merges edits and sends
 * at most 20 a second, the last one always.
 */

import { parseServerMessage } from "../protocol/messages";
import type { ClientMessage, View, Edit, ServerMessage } from "../protocol/types";
import { Connection, type ConnectionState } from "./connection";
import { Throttle } from "./throttle";

/** 20 edits a second are smooth under a dragged slider; the server would merge more of them anyway. */
const EDIT_INTERVAL_MS = 50;

export interface StreamClientHandlers {
  readonly onState: (state: ConnectionState, detail: string | undefined) => void;
  /** Whatever was received before does not count any more: the next prefix is a whole surface. */
  readonly onReset: () => void;
  readonly onMessage: (message: ServerMessage) => void;
  readonly onChunk: (frame: ArrayBuffer) => void;
  /** A frame that broke the protocol. The session starts over. */
  readonly onBroken: (reason: string) => void;
  /** An edit went out. */
  readonly onEditSent: () => void;
}

export class StreamClient {
  private readonly connection: Connection;
  private readonly throttle: Throttle;
  /** What to open, once known. */
  private target: { readonly volume: string; readonly step: number } | undefined;
  /** Values in force with the user's changes; undefined until the first `opened` of the target. */
  private wanted: View | undefined;
  /** Changes that were not sent yet. */
  private unsent: Edit = {};
  private opened = false;

  constructor(
    url: string,
    private readonly handlers: StreamClientHandlers,
  ) {
    this.throttle = new Throttle(EDIT_INTERVAL_MS, () => this.flush());
    this.connection = new Connection(url, {
      onOpen: () => this.sendOpen(),
      onText: (text) => this.receive(text),
      // What still arrives after an `open` was sent belongs to what was open before.
      onBinary: (frame) => {
        if (this.opened) this.handlers.onChunk(frame);
      },
      onState: (state, detail) => {
        if (state !== "connected") this.opened = false;
        this.handlers.onState(state, detail);
      },
    });
  }

  get framesSent(): number {
    return this.connection.framesSent;
  }

  /** Whether edits wait to be sent. */
  get dirty(): boolean {
    return Object.keys(this.unsent).length > 0;
  }

  /** Whether the server answered the last `open`. */
  get ready(): boolean {
    return this.opened;
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

  /** Starts over on a new socket, with the same wishes. */
  restart(): void {
    this.opened = false;
    this.connection.restart();
  }

  /**
   * Opens a volume at a time step. Another step of the open volume keeps the edit, another volume starts with its own.
   */
  open(volume: string, step: number): void {
    if (this.target?.volume !== volume) this.wanted = undefined;
    this.target = { volume, step };
    this.unsent = {};
    this.throttle.cancel();
    this.sendOpen();
  }

  /** Merges a change; it is sent soon. Before `opened` it has nothing to change and is refused with `false`. */
  edit(change: Edit): boolean {
    if (this.wanted === undefined) return false;
    this.wanted = { ...this.wanted, ...change };
    this.unsent = { ...this.unsent, ...change };
    if (this.opened) this.throttle.call();
    return true;
  }

  /** Keeps a change the server need not hear of now: it goes along when the session is restored. */
  remember(change: Edit): void {
    if (this.wanted !== undefined) this.wanted = { ...this.wanted, ...change };
  }

  /** The first prefix of a generation is on screen. */
  drawn(generation: number): void {
    if (this.opened) this.send({ type: "drawn", generation });
  }

  private sendOpen(): void {
    this.opened = false;
    if (this.target === undefined) return;
    this.send({ type: "open", ...this.target });
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
    if (message.type === "opened") {
      // An answer to an `open` that was replaced while it was under way.
      if (message.volume.id !== this.target?.volume || message.step !== this.target.step) return;
      this.handlers.onReset();
      this.opened = true;
      // The server starts from its own values; the user's replace them, where there are any.
      const change = this.wanted ?? {};
      this.wanted = { ...message.edit, ...change };
      this.handlers.onMessage({ ...message, edit: this.wanted });
      this.unsent = {};
      this.sendEdit(change);
      return;
    }
    if (this.opened || message.type === "error") this.handlers.onMessage(message);
  }

  private flush(): void {
    if (!this.opened || !this.dirty) return;
    const change = this.unsent;
    this.unsent = {};
    this.sendEdit(change);
  }

  private sendEdit(change: Edit): void {
    if (this.send({ type: "edit", ...change })) this.handlers.onEditSent();
  }

  private send(message: ClientMessage): boolean {
    return this.connection.send(JSON.stringify(message));
  }
}
