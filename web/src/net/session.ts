/** Authentication of the page: by a token in its address, which is exchanged for a cookie, or by an issuer at which users sign in. Neither appears in
* the history or in a copied link. */

import { request } from "./credentials";
import { ask } from "./rest";
import type { EmbedInfo, SessionInfo } from "../protocol/types";

/** An address without a part of its fragment, and that part. */
function without(name: string, href: string): { readonly href: string; readonly value: string | undefined } {
  const url = new URL(href);
  const parts = url.hash.slice(1).split("&");
  const value = parts.find((part) => part.startsWith(name))?.slice(name.length);
  if (value === undefined) return { href, value };
  url.hash = parts.filter((part) => !part.startsWith(name)).join("&");
  return { href: url.href.replace(/#$/, ""), value };
}

/** An address without the token, and the token. */
export function withoutToken(href: string): { readonly href: string; readonly token: string | undefined } {
  const { href: rest, value } = without("token=", href);
  return { href: rest, token: value };
}

/** Reason why a user who came back from the issuer was refused. */
let refusal: string | undefined;

/** Removes a refusal from the page's address. Must run before the address is read as a link. */
export function takeRefusal(): void {
  const { href, value } = without("sign-in-failed=", window.location.href);
  if (value === undefined) return;
  window.history.replaceState(null, "", href);
  refusal = decodeURIComponent(value);
}

/** Removes a token from the page's address and sends it to the server. Must run before all other requests. */
export async function enter(base: URL): Promise<void> {
  const { href, token } = withoutToken(window.location.href);
  if (token === undefined) return;
  window.history.replaceState(null, "", href);
  const shown = { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ token }) };
  // If the server is unreachable or refuses the token, the connection fails too and reports it.
  await fetch(new URL("api/v1/session", base), shown).catch(() => undefined);
}

/** The issuer at which users sign in, and the address for it. */
export interface SignIn {
  readonly issuer: string;
  readonly href: string;
  /** Why the last attempt of this page failed, if it did. */
  readonly refusal: string | undefined;
}

/** The server's issuer, if it has one. */
export async function signInOf(base: URL): Promise<SignIn | undefined> {
  const response = await fetch(new URL("api/v1/oidc", base)).catch(() => undefined);
  if (response?.ok !== true) return undefined;
  const { signIn } = (await response.json()) as { signIn: { issuer: string; login: string } | null };
  return signIn === null ? undefined : { issuer: signIn.issuer, href: new URL(signIn.login, base).href, refusal };
}

/** Ends the session here, and at the address that the issuer names. */
export async function signOut(base: URL): Promise<void> {
  const response = await fetch(new URL("api/v1/session", base), { method: "DELETE" });
  const answer = response.ok ? ((await response.json()) as { endSession: string | null }) : undefined;
  if (typeof answer?.endSession === "string") window.location.assign(answer.endSession);
  else window.location.reload();
}

/** What this page may do; `undefined` if the server cannot be reached, or is too old to have this endpoint. */
export async function sessionOf(base: URL): Promise<SessionInfo | "refused" | undefined> {
  const response = await request(new URL("api/v1/session", base)).catch(() => undefined);
  if (response?.status === 401) return "refused";
  return response?.status === 200 ? ((await response.json()) as SessionInfo) : undefined;
}

/** Whether the server is reachable and requires a token that this page does not have. */
export async function isRefused(base: URL): Promise<boolean> {
  return (await sessionOf(base)) === "refused";
}

/**
 * Origins of pages that may have this one in a frame, its own among them.
 *
 * @throws if the server cannot be reached
 */
export async function embedOrigins(base: URL): Promise<readonly string[]> {
  const response = await ask(new URL("api/v1/embed", base), {});
  return [base.origin, ...((await response.json()) as EmbedInfo).origins];
}
