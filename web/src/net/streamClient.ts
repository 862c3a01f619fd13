/**
 * Client of the stream: opens a volume at a step and edits its view. Repeats both on a new connection, merges edits, and sends
 * at most 20 of them a second, always including the last one.
 */

import { parseServerMessage } from "../protocol/messages";
import type { ClientMessage, Edit, ServerMessage, View } from "../protocol/types";
import { Connection, type ConnectionState } from "./connection";
import { Throttle } from "./throttle";

/** 20 edits a second are smooth under a dragged slider; the server would merge more of them anyway. */
const EDIT_INTERVAL_MS = 50;

export interface StreamClientHandlers {
  /** `reason`: why the connection was closed, where that is known. */
  readonly onState: (state: ConnectionState, reason: string | undefined) => void;
  /** To the server this client holds nothing any more: the next prefix is a whole surface. */
  readonly onReset: () => void;
  readonly onMessage: (message: ServerMessage) => void;
  readonly onChunk: (frame: ArrayBuffer) => void;
  /** A frame broke the protocol. The client connects anew by itself. */
  readonly onBroken: (reason: string) => void;
  /** An edit was sent. */
  readonly onEditSent: () => void;
}

export class StreamClient {
  private readonly connection: Connection;
  private readonly throttle: Throttle;
  /** What to open, once known. */
  private target: { readonly volume: string; readonly step: number } | undefined;
  /** Values in force, with edits that were not sent yet; undefined until the first `opened` of the target. */
  private wanted: View | undefined;
  /** Edits that were not sent yet, merged. */
  private unsent: Edit = {};
  /** The server has answered the last `open`. */
  private opened = false;

  constructor(
    url: string,
    private readonly handlers: StreamClientHandlers,
  ) {
    this.throttle = new Throttle(EDIT_INTERVAL_MS, () => this.flush());
    this.connection = new Connection(url, {
      onOpen: () => this.sendOpen(),
      onText: (text) => this.receive(text),
      // Chunks that arrive between an `open` and its `opened` belong to the volume before.
      onBinary: (frame) => {
        if (this.opened) this.handlers.onChunk(frame);
      },
      onState: (state, reason) => {
        if (state !== "connected") this.opened = false;
        this.handlers.onState(state, reason);
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

  /** Connects anew and repeats `open` and the edits. */
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

  /** Merges an edit; it is sent soon. `false` before `opened`: there is no view to edit yet. */
  edit(edit: Edit): boolean {
    if (this.wanted === undefined) return false;
    this.wanted = { ...this.wanted, ...edit };
    this.unsent = { ...this.unsent, ...edit };
    if (this.opened) this.throttle.call();
    return true;
  }

  /** Keeps an edit that changes nothing on the server; it is sent with the others on a new connection. */
  remember(edit: Edit): void {
    if (this.wanted !== undefined) this.wanted = { ...this.wanted, ...edit };
  }

  /** The first prefix of a generation is on screen. */
  acknowledge(generation: number): void {
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
      // The reply to an earlier `open`.
      if (message.volume.id !== this.target?.volume || message.step !== this.target.step) return;
      this.handlers.onReset();
      this.opened = true;
      // The server starts from its own values; the user's replace them, where there are any.
      const edit = this.wanted ?? {};
      this.wanted = { ...message.edit, ...edit };
      this.handlers.onMessage({ ...message, edit: this.wanted });
      this.unsent = {};
      this.sendEdit(edit);
      return;
    }
    // Messages of a generation that arrive between an `open` and its `opened` belong to the volume before.
    if (this.opened || message.type === "error" || message.type === "opening") this.handlers.onMessage(message);
  }

  private flush(): void {
    if (!this.opened || !this.dirty) return;
    const edit = this.unsent;
    this.unsent = {};
    this.sendEdit(edit);
  }

  private sendEdit(edit: Edit): void {
    if (this.send({ type: "edit", ...edit })) this.handlers.onEditSent();
  }

  private send(message: ClientMessage): boolean {
    return this.connection.send(JSON.stringify(message));
  }
}
