/** One WebSocket at a time, opened again with growing pauses when it closes. Knows frames, not what they mean. */

import { SUBPROTOCOL } from "../protocol/types";

export type ConnectionState = "connecting" | "connected" | "waiting" | "stopped";

export interface ConnectionHandlers {
  /** A fresh socket is open: nothing of earlier sockets is known to the server. */
  readonly onOpen: () => void;
  readonly onText: (text: string) => void;
  readonly onBinary: (frame: ArrayBuffer) => void;
  /** `detail` is for the user: why the socket closed, where that is known; `undefined` when there is nothing to say. */
  readonly onState: (state: ConnectionState, detail: string | undefined) => void;
}

/** What close codes of PROTOCOL.md section 5 mean to a user. */
const CLOSE_REASONS: Readonly<Record<number, string>> = {
  1001: "the server is shutting down",
  1003: "the server refused a binary frame",
  1009: "a message was over 64 KiB",
  4000: "the server refused 16 messages in a row",
  4001: "this viewer read too slowly and was disconnected",
  4002: "the server has as many viewers as it takes",
  4003: "the server heard nothing of this viewer for 90 s",
};

const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 8000;
/** A socket that lived this long was a good one: the next pause is short again. */
const GOOD_LIFE_MS = 3000;

export class Connection {
  private socket: WebSocket | undefined;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private pauseMs = FIRST_PAUSE_MS;
  private openedAt = Infinity;
  private stopped = false;
  private sent = 0;

  constructor(
    private readonly url: string,
    private readonly handlers: ConnectionHandlers,
  ) {}

  /** Text frames sent over all sockets of this page. */
  get framesSent(): number {
    return this.sent;
  }

  start(): void {
    this.stopped = false;
    this.connect();
  }

  /** Sends a text frame; `false` when no socket is open (whoever restores the session sends it then). */
  send(text: string): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(text);
    this.sent += 1;
    return true;
  }

  /** Gives up this socket and opens another, for instance because the server broke the protocol. */
  restart(): void {
    this.drop();
    this.retry(undefined);
  }

  /** Connects at once if a pause is running. */
  retryNow(): void {
    if (this.timer === undefined) return;
    clearTimeout(this.timer);
    this.connect();
  }

  stop(): void {
    this.stopped = true;
    clearTimeout(this.timer);
    this.timer = undefined;
    this.drop();
    this.handlers.onState("stopped", undefined);
  }

  private connect(): void {
    this.timer = undefined;
    this.handlers.onState("connecting", undefined);
    const socket = new WebSocket(this.url, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    // Events of a socket that was given up are nobody's business any more.
    const current = () => this.socket === socket;
    socket.onopen = () => {
      if (!current()) return;
      this.openedAt = performance.now();
      this.handlers.onState("connected", undefined);
      this.handlers.onOpen();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (!current()) return;
      if (typeof event.data === "string") this.handlers.onText(event.data);
      else this.handlers.onBinary(event.data);
    };
    socket.onclose = (event) => {
      if (!current()) return;
      this.socket = undefined;
      this.retry(CLOSE_REASONS[event.code] ?? (event.reason === "" ? undefined : event.reason));
    };
  }

  private retry(detail: string | undefined): void {
    if (this.stopped) return;
    if (performance.now() - this.openedAt > GOOD_LIFE_MS) this.pauseMs = FIRST_PAUSE_MS;
    this.openedAt = Infinity;
    // Up to a quarter more, so that viewers of a restarted server do not return in step.
    const pause = this.pauseMs * (1 + Math.random() / 4);
    this.pauseMs = Math.min(this.pauseMs * 2, LONGEST_PAUSE_MS);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), pause);
    this.handlers.onState("waiting", detail);
  }

  private drop(): void {
    const socket = this.socket;
    this.socket = undefined;
    socket?.close(1000);
  }
}
