/** The token of a frame in a page of another site: asked for, taken from an origin that the server names, and asked for anew before it ends. */

import type { HostPort } from "../embed/hostPort";
import { RequestError } from "../embed/requests";
import { hold, holdsToken } from "../net/credentials";
import { embedOrigins } from "../net/session";
import type { SessionInfo } from "../protocol/types";

/** The next token is asked for this long before the end, or at half time where that is later: its maker may have to be asked. */
const AHEAD_SECONDS = 60;

/** While the page around has one made, it is not asked again with each attempt to connect: it would have another one made. */
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

  /** Asks the page around, because the server has refused this one. */
  ask(): void {
    const now = performance.now();
    if (now - this.askedAt < ASK_AGAIN_MS) return;
    this.askedAt = now;
    void this.emit(holdsToken() ? "expired" : "wanted");
  }

  /** @throws RequestError where the origin may not hand one over, Error where the server does not take it */
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

  /** Those that the server lets have this page in a frame, which its policy tells the browser too. Asked again where the server was away. */
  private origins(): Promise<readonly string[]> {
    this.allowed ??= embedOrigins(this.base).catch((error: unknown) => {
      this.allowed = undefined;
      throw error;
    });
    return this.allowed;
  }
}
