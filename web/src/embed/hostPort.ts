/** The channel to the embedding page: only messages of its window are accepted, and only from allowed origins. */

import { idOf, isForIsopeel, readRequest, VERSION, type HostRequest } from "./requests";

/** Events that the embedding page receives. */
export type HostEvent =
  /** Requests are answered from now on. */
  | { readonly type: "ready"; readonly volumes: readonly { readonly id: string; readonly title: string }[] }
  /** The final surface is on screen. */
  | ({ readonly type: "settled" } & PageState)
  /** Requests a token: there is none, the server no longer accepts it, or it ends soon. */
  | { readonly type: "token"; readonly reason: "wanted" | "expiring" | "expired" }
  /** A message to the user about something that failed. */
  | { readonly type: "error"; readonly message: string };

/** Answer to `get`. */
export interface PageState {
  /** As an address has it behind `#`; `null` while no volume is open. */
  readonly link: string | null;
  /** The final surface is on screen. */
  readonly settled: boolean;
  readonly triangles: number;
  /** Of the surface that is not decimated; `null` if it is not known yet. */
  readonly fullTriangles: number | null;
}

/** The part of the browser's window that is used; tests pass their own. */
export interface PageWindow {
  readonly parent: { postMessage(message: unknown, targetOrigin: string): void };
  addEventListener(type: "message", listener: (event: MessageEvent) => void): void;
}

/** Requests under way at once; images take long. */
const MAX_PENDING = 8;

export class HostPort {
  private pending = 0;
  /** Origin of the embedding page, once it is known to be an allowed one. */
  private host: string | undefined;

  /**
   * @param around origin of the embedding page, if the browser reports it
   * @param answer returns the answer to a request of an origin; if it throws, the answer is the error's message
   */
  constructor(
    private readonly page: PageWindow,
    private readonly origins: readonly string[],
    around: string | undefined,
    private readonly answer: (request: HostRequest, origin: string) => unknown,
  ) {
    this.host = around;
    if (this.isFramed) page.addEventListener("message", (event) => void this.receive(event));
  }

  /** A page in no frame is its own parent: it would answer itself without end. */
  get isFramed(): boolean {
    return (this.page.parent as unknown) !== this.page;
  }

  /** @param among to pages of these origins alone, of those that may speak */
  emit(event: HostEvent, among: readonly string[] = this.origins): void {
    if (!this.isFramed) return;
    // Sent to another origin, the browser would only complain on its console.
    const targets = this.origins.filter((origin) => among.includes(origin) && (this.host === undefined || origin === this.host));
    for (const origin of targets) this.page.parent.postMessage({ isopeel: VERSION, ...event }, origin);
  }

  private async receive({ data, origin, source }: MessageEvent): Promise<void> {
    if (source !== this.page.parent || !isForIsopeel(data)) return;
    const id = idOf(data) ?? null;
    // Nothing in a refusal is a secret, and a page without an origin can be reached in no other way.
    const send = (message: object) => this.page.parent.postMessage({ isopeel: VERSION, type: "reply", id, ...message }, origin === "null" ? "*" : origin);
    if (!this.origins.includes(origin)) {
      const way = origin === "null" ? "a page without an origin cannot be let in" : `the address has to name it: ?embed&origin=${origin}`;
      return send({ ok: false, error: `isopeel takes no messages from ${origin}: ${way}` });
    }
    this.host = origin;
    if (this.pending >= MAX_PENDING) return send({ ok: false, error: `${MAX_PENDING} requests are under way, and no more are taken: wait for their answers` });
    this.pending += 1;
    try {
      send({ ok: true, value: await this.answer(readRequest(data), origin) });
    } catch (error) {
      send({ ok: false, error: error instanceof Error ? error.message : String(error) });
    } finally {
      this.pending -= 1;
    }
  }
}
