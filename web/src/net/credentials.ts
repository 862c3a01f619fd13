/**
 * The token that the page around this one has handed over: in the memory of this page alone, never in an address, a cookie or a store. Without one the
 * browser sends its cookie. Whoever asks the server for something does it by `request`.
 */

import type { SessionInfo } from "../protocol/types";

let held: string | undefined;

/** Whether a token was handed over. */
export function holdsToken(): boolean {
  return held !== undefined;
}

/** `fetch`, with the token if there is one. Then the cookie of somebody who has signed in here before stays out of it: it may be for more. */
export function request(url: URL, options: RequestInit = {}, token = held): Promise<Response> {
  if (token === undefined) return fetch(url, options);
  const headers = new Headers(options.headers);
  headers.set("authorization", `Bearer ${token}`);
  return fetch(url, { ...options, headers, credentials: "omit" });
}

/**
 * Uses a token from now on.
 *
 * @returns what it is for, and how long
 * @throws where the server does not take it; then the one before stays
 */
export async function hold(base: URL, token: string): Promise<SessionInfo> {
  const response = await request(new URL("api/v1/session", base), {}, token);
  if (response.status === 401) throw new Error("the server does not take this token: it is wrong, has expired or was revoked");
  if (!response.ok) throw new Error(`the server answered with HTTP ${response.status} when it was shown the token`);
  const session = (await response.json()) as SessionInfo;
  held = token;
  return session;
}

/** The stream of the server at `base`. */
export function streamUrl(base: URL): URL {
  const url = new URL("api/v1/stream", base);
  url.protocol = base.protocol === "https:" ? "wss:" : "ws:";
  return url;
}

/** Where a stream is opened. A browser sends no header with it: a ticket, which is of use once, stands for the token. */
export function streamAddress(stream: URL): string | Promise<string> {
  return held === undefined ? stream.href : withTicket(stream);
}

/** @throws where the server gives none */
async function withTicket(stream: URL): Promise<string> {
  const tickets = new URL("tickets", stream);
  tickets.protocol = stream.protocol === "wss:" ? "https:" : "http:";
  const response = await request(tickets, { method: "POST" });
  if (!response.ok) throw new Error(`no ticket for the stream: HTTP ${response.status}`);
  const { ticket } = (await response.json()) as { readonly ticket: string };
  const address = new URL(stream);
  address.searchParams.set("ticket", ticket);
  return address.href;
}
