/** Shows the state of the connection, and lists the volumes each time that it is made. */

import { isEqual } from "../protocol/equal";
import type { ConnectionState } from "../net/connection";
import { listUnreadable, listVolumes } from "../net/rest";
import { isRefused, sessionOf, signInOf } from "../net/session";
import type { VolumeSummary } from "../protocol/types";
import type { Model } from "../ui/model";

/** How often the server is asked for new volumes and time steps, if there may be some. */
const WATCH_MS = 3000;

const NO_TOKEN = "the server asks for a token: open the address that it printed when it started";

export class Connecting {
  private watching: ReturnType<typeof setInterval> | undefined;
  /** The server was asked and has not answered yet. */
  private isLooking = false;
  private listed: readonly VolumeSummary[] | undefined;

  /**
   * @param onVolumes the server's volumes, each time that the connection is made
   * @param onRefused the server asks for a token; returns what to tell the user, if another page is to have one
   */
  constructor(
    private readonly model: Model,
    private readonly base: URL,
    private readonly onVolumes: (volumes: readonly VolumeSummary[]) => void,
    private readonly onRefused: () => string | undefined,
  ) {}

  /** @param reason why the last connection was closed, if that is known */
  changed(state: ConnectionState, reason: string | undefined): void {
    const { model } = this;
    const isConnected = state === "connected";
    const { reason: before, signIn } = model.connection();
    model.connection.set({ isConnected, reason: state === "waiting" ? reason : before, ...(signIn === undefined ? {} : { signIn }) });
    if (state === "waiting") void this.explain();
    if (!isConnected) return;
    model.connection.set({ isConnected, reason: undefined });
    void this.loadVolumes();
    void sessionOf(this.base).then((session) => {
      if (session !== undefined && session !== "refused") model.session.set(session);
    });
    void signInOf(this.base).then((signIn) => {
      if (signIn !== undefined && model.connection().isConnected) model.connection.set({ isConnected, reason: undefined, canSignOut: true });
    });
  }

  /** A browser does not tell a page why a socket could not be opened. */
  private async explain(): Promise<void> {
    const { model, base } = this;
    if (!(await isRefused(base)) || model.connection().isConnected) return;
    const elsewhere = this.onRefused();
    if (elsewhere !== undefined) {
      model.connection.set({ isConnected: false, reason: elsewhere });
      return;
    }
    const signIn = await signInOf(base);
    if (model.connection().isConnected) return;
    if (signIn === undefined) {
      model.connection.set({ isConnected: false, reason: NO_TOKEN });
      return;
    }
    const { issuer, href, refusal } = signIn;
    const before = refusal === undefined ? "" : `You were not signed in: ${refusal}. `;
    model.connection.set({ isConnected: false, reason: `${before}Sign in at ${new URL(issuer).host} to use this server`, signIn: href });
  }

  /** Asks again and again while the page is seen. */
  watch(on: boolean): void {
    if (on === (this.watching !== undefined)) return;
    clearInterval(this.watching);
    this.watching = on ? setInterval(() => void this.look(), WATCH_MS) : undefined;
  }

  /** A list that cannot be read now may be the next time. */
  private async look(): Promise<void> {
    if (this.isLooking || document.hidden || !this.model.connection().isConnected) return;
    this.isLooking = true;
    const volumes = await listVolumes(this.base).catch(() => undefined);
    this.isLooking = false;
    if (volumes !== undefined && !isEqual(volumes, this.listed)) this.take(volumes);
  }

  private take(volumes: readonly VolumeSummary[]): void {
    this.listed = volumes;
    this.onVolumes(volumes);
  }

  /** Reloads the list of volumes. */
  async loadVolumes(): Promise<void> {
    let volumes: readonly VolumeSummary[];
    try {
      volumes = await listVolumes(this.base);
    } catch (error) {
      const reason = error instanceof Error ? error.message : String(error);
      this.model.offerRetry(`The list of volumes could not be read: ${reason}`, () => void this.loadVolumes());
      return;
    }
    this.take(volumes);
    await this.showUnreadable();
  }

  /** Says which paths the server cannot read, and why. A server that does not answer that has said so above. */
  private async showUnreadable(): Promise<void> {
    const paths = await listUnreadable(this.base).catch(() => []);
    for (const { name, reason } of paths) this.model.toast(`The server cannot read ${name}: ${reason}`, "lasting");
  }
}
