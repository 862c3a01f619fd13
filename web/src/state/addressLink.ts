/** The address of the page: written as the state changes, read when the page opens and when the user changes it. */

import { decodeLink, encodeLink, type Link, type LinkState } from "./link";
import { LinkError } from "./linkReader";

/** The state is written this long after its last change: a drag changes it many times. */
const WRITE_DELAY_MS = 400;

export interface AddressHandlers {
  /** The address asks for this. */
  readonly onLink: (link: Link) => void;
  /** The address asks for something that cannot be read. */
  readonly onBroken: (reason: string) => void;
  /** The state now; `undefined` while there is none to link to. */
  readonly link: () => LinkState | undefined;
}

export class AddressLink {
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** The part of the address after `#` that was read or written last. */
  private known: string;

  constructor(private readonly handlers: AddressHandlers) {
    window.addEventListener("hashchange", () => {
      if (window.location.hash === this.known) return;
      this.known = window.location.hash;
      this.read();
    });
    restoreUnwritten();
    this.known = window.location.hash;
    window.addEventListener("pagehide", () => {
      const state = this.timer === undefined || this.isChanged ? undefined : this.handlers.link();
      if (state !== undefined) keepUnwritten(encodeLink(state));
    });
  }

  /** The user has changed the address, and its event has not arrived: the state of before must not replace it. */
  private get isChanged(): boolean {
    const { hash } = window.location;
    return hash !== "" && hash !== this.known;
  }

  /** Follows the address. `false`: it asks for nothing. */
  read(): boolean {
    try {
      const link = decodeLink(window.location.hash);
      if (link === undefined) return false;
      this.handlers.onLink(link);
      return true;
    } catch (error) {
      if (!(error instanceof LinkError)) throw error;
      this.handlers.onBroken(error.message);
      return false;
    }
  }

  /** Writes the state into the address, and returns the address. */
  write(): string {
    clearTimeout(this.timer);
    this.timer = undefined;
    const state = this.handlers.link();
    if (state === undefined || this.isChanged) return window.location.href;
    const address = new URL(window.location.href);
    address.hash = encodeLink(state);
    // Read back: the browser may have escaped some characters.
    this.known = address.hash;
    if (address.href !== window.location.href) window.history.replaceState(null, "", address);
    return address.href;
  }

  writeSoon(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.write(), WRITE_DELAY_MS);
  }
}

/** State that was not written yet when the page was left: a reload begins with the address of before. Storage may be forbidden. */
const UNWRITTEN = "isopeel.unwritten";

function keepUnwritten(link: string): void {
  try {
    sessionStorage.setItem(UNWRITTEN, JSON.stringify([window.location.href, link]));
  } catch {
    // The address of before stays.
  }
}

function restoreUnwritten(): void {
  try {
    const [from, link] = JSON.parse(sessionStorage.getItem(UNWRITTEN) ?? "[]") as readonly unknown[];
    sessionStorage.removeItem(UNWRITTEN);
    if (from === window.location.href && typeof link === "string") window.history.replaceState(null, "", `#${link}`);
  } catch {
    // As if nothing had been kept.
  }
}
