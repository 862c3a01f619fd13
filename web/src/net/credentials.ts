/**
 * The token that the embedding page has handed over. It is kept in the memory of this page alone, never in an address, a cookie or a store.
 * Without a token the browser sends its cookie. All requests to the server go through `request`.
 */

import type { SessionInfo } from "../protocol/types";

let held: string | undefined;

/** Whether a token was handed over. */
export function holdsToken(): boolean {
  return held !== undefined;
}

/**
 * `fetch`, with the token if there is one. With a token the cookie of a user who has signed in here before is not sent: it may allow more.
 */
export function request(url: URL, options: RequestInit = {}, token = held): Promise<Response> {
  if (token === undefined) return fetch(url, options);
  const headers = new Headers(options.headers);
  headers.set("authorization", `Bearer ${token}`);
  return fetch(url, { ...options, headers, credentials: "omit" });
}

/**
 * Uses a token from now on.
 *
 * @returns its roles and its expiry
 * @throws if the server does not accept it; then the previous token stays
 */
export async function hold(base: URL, token: string): Promise<SessionInfo> {
  const response = await request(new URL("api/v1/session", base), {}, token);
  if (response.status === 401) throw new Error("the server does not take this token: it is wrong, has expired or was revoked");
  if (!response.ok) throw new Error(`the server answered with HTTP ${response.status} when it was shown the token`);
  const session = (await response.json()) as SessionInfo;
  held = token;
  return session;
}

/** The stream of the server at `base`. A proxy of several servers sends viewers of one volume to one server; a server ignores the volume. */
export function streamUrl(base: URL, volume?: string): URL {
  const url = new URL("api/v1/stream", base);
  url.protocol = base.protocol === "https:" ? "wss:" : "ws:";
  if (volume !== undefined) url.searchParams.set("volume", volume);
  return url;
}

/** Address at which a stream is opened. A browser sends no header with it, so a ticket, which is valid once, stands for the token. */
export function streamAddress(stream: URL): string | Promise<string> {
  return held === undefined ? stream.href : withTicket(stream);
}

/** @throws if the server issues no ticket */
async function withTicket(stream: URL): Promise<string> {
  const tickets = new URL("tickets", stream);
  tickets.protocol = stream.protocol === "wss:" ? "https:" : "http:";
  // The server that issues a ticket accepts it.
  tickets.search = stream.search;
  const response = await request(tickets, { method: "POST" });
  if (!response.ok) throw new Error(`no ticket for the stream: HTTP ${response.status}`);
  const { ticket } = (await response.json()) as { readonly ticket: string };
  const address = new URL(stream);
  address.searchParams.set("ticket", ticket);
  return address.href;
}
