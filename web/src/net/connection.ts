/** One WebSocket at a time, opened again with growing pauses when it closes. Passes frames on without reading them. */

import { Heartbeat } from "./heartbeat";
import { SUBPROTOCOL } from "../protocol/generated";

export type ConnectionState = "connecting" | "connected" | "waiting" | "stopped";

export interface ConnectionHandlers {
  /** A new socket is open: the server knows nothing of earlier ones. */
  readonly onOpen: () => void;
  readonly onText: (text: string) => void;
  readonly onBinary: (frame: ArrayBuffer) => void;
  /** `reason`: for the user, why the socket closed, if that is known. */
  readonly onState: (state: ConnectionState, reason: string | undefined) => void;
}

/** The close codes of section 5 of PROTOCOL.md in words for the user. */
const CLOSE_REASONS: Readonly<Record<number, string>> = {
  1001: "the server is shutting down",
  1002: "the server refused a frame that breaks the protocol",
  1003: "the server refused a binary frame",
  1007: "the server refused text that is not UTF-8",
  1009: "a message was over 64 KiB",
  4000: "the server refused 16 messages in a row",
  4001: "this viewer read too slowly and was disconnected",
  4002: "the server has as many viewers as it takes",
  4003: "the server heard nothing of this viewer for a while",
  4004: "the token has expired or was revoked",
};

const FIRST_PAUSE_MS = 250;
const MAX_PAUSE_MS = 8000;
/** After a socket that was open this long, the next pause is the shortest again. */
const STABLE_AFTER_MS = 3000;
/** Time-out of connecting: a socket that is not open by then counts as failed. */
const CONNECT_MS = 8000;

export class Connection {
  private readonly heartbeat = new Heartbeat((seconds) => {
    this.drop();
    this.retry(`nothing has come from the server for ${seconds} s`);
  });
  private socket: WebSocket | undefined;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private pauseMs = FIRST_PAUSE_MS;
  private openedAt = Infinity;
  private stopped = false;
  private sent = 0;
  /** Counts the requested addresses: the answer to an earlier request is ignored. */
  private attempt = 0;

  /** @param address returns the address at which the next socket is opened; it is rejected if there is none now */
  constructor(
    private readonly address: () => string | Promise<string>,
    private readonly handlers: ConnectionHandlers,
  ) {}

  /** Text frames sent over all sockets of this page. */
  get framesSent(): number {
    return this.sent;
  }

  /** Whether a pause is running. */
  get isWaiting(): boolean {
    return this.timer !== undefined;
  }

  start(): void {
    this.stopped = false;
    this.connect();
  }

  /** Sends a text frame; `false` when no socket is open. */
  send(text: string): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(text);
    this.sent += 1;
    return true;
  }

  /** The server promises to send a frame at least this often. If several of them are missing, the socket counts as dead. */
  expectWithin(seconds: number): void {
    this.heartbeat.promised(seconds);
  }

  /** Closes this socket and opens another, for instance because the server broke the protocol. */
  restart(): void {
    this.drop();
    this.retry(undefined);
  }

  /** Closes this socket and opens another at once, at another address. */
  reopen(): void {
    this.drop();
    clearTimeout(this.timer);
    this.connect();
  }

  /** Connects at once if a pause is running. */
  retryNow(): void {
    if (!this.isWaiting) return;
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
    const address = this.address();
    if (typeof address === "string") return this.open(address);
    const attempt = (this.attempt += 1);
    const isCurrent = () => !this.stopped && this.attempt === attempt;
    address.then(
      (found) => isCurrent() && this.open(found),
      () => isCurrent() && this.retry(undefined),
    );
  }

  private open(address: string): void {
    const socket = new WebSocket(address, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    // Events of a socket that was closed are ignored.
    const current = () => this.socket === socket;
    const late = setTimeout(() => {
      if (!current()) return;
      this.drop();
      this.retry("the server does not answer");
    }, CONNECT_MS);
    socket.onopen = () => {
      clearTimeout(late);
      if (!current()) return;
      this.openedAt = performance.now();
      this.handlers.onState("connected", undefined);
      this.handlers.onOpen();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (!current()) return;
      this.heartbeat.heard();
      if (typeof event.data === "string") this.handlers.onText(event.data);
      else this.handlers.onBinary(event.data);
    };
    socket.onclose = (event) => {
      clearTimeout(late);
      if (!current()) return;
      this.heartbeat.stop();
      this.socket = undefined;
      this.retry(CLOSE_REASONS[event.code] ?? (event.reason === "" ? undefined : event.reason));
    };
  }

  private retry(reason: string | undefined): void {
    if (this.stopped) return;
    if (performance.now() - this.openedAt > STABLE_AFTER_MS) this.pauseMs = FIRST_PAUSE_MS;
    this.openedAt = Infinity;
    // Up to a quarter more, so that viewers of a restarted server do not return in step.
    const pause = this.pauseMs * (1 + Math.random() / 4);
    this.pauseMs = Math.min(this.pauseMs * 2, MAX_PAUSE_MS);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), pause);
    this.handlers.onState("waiting", reason);
  }

  private drop(): void {
    const socket = this.socket;
    this.heartbeat.stop();
    this.socket = undefined;
    this.attempt += 1;
    socket?.close(1000);
  }
}
