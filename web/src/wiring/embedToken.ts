/** Token of a frame in a page of another site: requested from the page, accepted only from an origin that the server names, and renewed before it expires. */

import type { HostPort } from "../embed/hostPort";
import { RequestError } from "../embed/requests";
import { hold, holdsToken } from "../net/credentials";
import { embedOrigins } from "../net/session";
import type { SessionInfo } from "../protocol/types";

/** The next token is requested this long before the end, or at half time if that is later: its maker may have to be asked. */
const AHEAD_SECONDS = 60;

/** Shortest time between two requests to the embedding page: a request with each attempt to connect would make it fetch another token. */
const ASK_AGAIN_MS = 5000;

/** What timers take; longer ones would end at once. */
const MAX_TIMER_MS = 2 ** 31 - 1;

export class EmbedToken {
  private allowed: Promise<readonly string[]> | undefined;
  private askedAt = -Infinity;
  private timer: ReturnType<typeof setTimeout> | undefined;

  /** @param onTaken a token was taken: what waits for one goes on */
  constructor(
    private readonly port: HostPort,
    private readonly base: URL,
    private readonly onTaken: () => void,
  ) {}

  /** Requests a token from the embedding page, because the server has refused this one. */
  ask(): void {
    const now = performance.now();
    if (now - this.askedAt < ASK_AGAIN_MS) return;
    this.askedAt = now;
    void this.emit(holdsToken() ? "expired" : "wanted");
  }

  /** @throws RequestError if the origin may not hand one over, Error if the server does not accept it */
  async take(token: string, origin: string): Promise<SessionInfo> {
    const allowed = await this.origins();
    if (!allowed.includes(origin)) {
      throw new RequestError(`the server takes no token from a page of ${origin}: --embed-origin names those that may hand one over`);
    }
    const session = await hold(this.base, token);
    this.askedAt = -Infinity;
    this.plan(session.expiresSeconds);
    this.onTaken();
    return session;
  }

  private plan(seconds: number | null): void {
    clearTimeout(this.timer);
    if (seconds === null) return;
    const after = 1000 * Math.max(seconds - AHEAD_SECONDS, seconds / 2);
    this.timer = setTimeout(() => void this.emit("expiring"), Math.min(after, MAX_TIMER_MS));
  }

  private async emit(reason: "wanted" | "expiring" | "expired"): Promise<void> {
    const allowed = await this.origins().catch(() => []);
    if (allowed.length === 0) this.askedAt = -Infinity;
    this.port.emit({ type: "token", reason }, allowed);
  }

  /**
   * The origins that the server lets embed this page, which its policy also tells the browser. Requested again if the server could not be
   * reached.
   */
  private origins(): Promise<readonly string[]> {
    this.allowed ??= embedOrigins(this.base).catch((error: unknown) => {
      this.allowed = undefined;
      throw error;
    });
    return this.allowed;
  }
}
