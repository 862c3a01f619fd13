/** The token in the page's address, which the server takes for a cookie: it stands in no history and no copied link. */

const NAME = "token=";

/** An address without the token, and the token. */
export function withoutToken(href: string): { readonly href: string; readonly token: string | undefined } {
  const url = new URL(href);
  const parts = url.hash.slice(1).split("&");
  const token = parts.find((part) => part.startsWith(NAME))?.slice(NAME.length);
  if (token === undefined) return { href, token };
  url.hash = parts.filter((part) => !part.startsWith(NAME)).join("&");
  return { href: url.href.replace(/#$/, ""), token };
}

/** Takes a token out of the page's address and shows it to the server. Before anything else is asked of it. */
export async function enter(base: URL): Promise<void> {
  const { href, token } = withoutToken(window.location.href);
  if (token === undefined) return;
  window.history.replaceState(null, "", href);
  const request = { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ token }) };
  // A server that is away, or refuses it, is met again by the connection, which says so.
  await fetch(new URL("api/v1/session", base), request).catch(() => undefined);
}

/** Whether the server is there, and asks for a token that this page does not have. */
export async function isRefused(base: URL): Promise<boolean> {
  const response = await fetch(new URL("api/v1/session", base)).catch(() => undefined);
  return response?.status === 401;
}
