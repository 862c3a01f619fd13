/** The notice above the surface while there is no connection. */

import { button } from "./controls";
import { h, setText } from "./dom";

/** The notice appears after this long without a connection. */
const DELAY_MS = 1200;

export class ConnectionBanner {
  readonly element = h("div", { class: "banner", role: "status", hidden: true });
  private readonly text = h("span");
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(onRetry: () => void) {
    this.element.append(this.text, button("Retry now", "Connect at once", onRetry, "button quiet"));
  }

  connected(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.element.hidden = true;
  }

  /** There is no connection, or not yet. `reason`: why the last one was closed, where that is known. */
  disconnected(reason: string | undefined): void {
    if (reason !== undefined) setText(this.text, `Connection closed: ${reason}. Reconnecting`);
    else if (this.element.hidden) setText(this.text, "No connection to the server. Reconnecting");
    this.timer ??= setTimeout(() => (this.element.hidden = false), DELAY_MS);
  }
}
