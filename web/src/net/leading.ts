/**
 * Keeps the group that this tab leads over a reload of its page: in the tab's session storage from unload to load, and at no other time, so that a
 * copy of the tab does not get it. If the page may not use storage, a reload ends the group.
 */

import { ASKED_CODINGS } from "../protocol/chunk";
import type { ClientMessage } from "../protocol/generated";

/** A group, and the secret key with which this tab resumes leading it. */
export interface Leading extends Place {
  readonly group: string;
  readonly key: string;
}

/** Where the members of a group meet: at the server to which a proxy sends the viewers of this volume. */
interface Place {
  readonly via?: string;
}

/** A group that is followed, and the follower's name in it. */
export interface Joined extends Place {
  readonly group: string;
  readonly name?: string;
}

/** The message that joins a group. */
export const joining = ({ group, name }: Joined): ClientMessage => ({ type: "join", name: name ?? null, group, codings: [...ASKED_CODINGS] });

/** The message that leads a group again. */
export const leadingAgain = ({ group, key }: Leading): ClientMessage => ({ type: "lead", resume: { group, key }, codings: [...ASKED_CODINGS] });

/** The volume by which members of a group meet, if there is one. */
export const placeOf = (via: string | undefined): Place => (via === undefined ? {} : { via });

const KEY = "isopeel-leads";
/** The server waits half as long for the leader; a tab that is reopened later does not lead any more. */
const MAX_AGE_MS = 60_000;

/** Keeps it while the page is away. */
export function keepLeading(leading: Leading | undefined, now = Date.now()): void {
  if (leading === undefined) return;
  try {
    sessionStorage.setItem(KEY, JSON.stringify({ ...leading, at: now }));
  } catch {
    // Storage is forbidden or full: the group waits in vain and ends.
  }
}

/** Takes it out of the storage. */
export function takeLeading(now = Date.now()): Leading | undefined {
  try {
    const kept = sessionStorage.getItem(KEY);
    sessionStorage.removeItem(KEY);
    const { group, key, via, at } = JSON.parse(kept ?? "{}") as Partial<Leading> & { readonly at?: number };
    if (typeof group !== "string" || typeof key !== "string" || typeof at !== "number") return undefined;
    return now - at < MAX_AGE_MS ? { group, key, ...placeOf(via) } : undefined;
  } catch {
    return undefined;
  }
}
