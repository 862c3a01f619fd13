/** Origins of pages that may send requests to an embedded page. Pure. */

/** Options in the address of an embedded page: `?embed&origin=https://example.org`. */
export interface EmbedOptions {
  /** Origins of pages that may send requests to this one: its own, and those that the address names. */
  readonly origins: readonly string[];
  /** Names in the address that are no origins, for the user. */
  readonly problems: readonly string[];
}

/**
 * @param search of the address, with its `?`
 * @param own origin of the page itself
 * @returns `undefined` if the page is not to be embedded
 */
export function embedOptions(search: string, own: string): EmbedOptions | undefined {
  const query = new URLSearchParams(search);
  if (!query.has("embed")) return undefined;
  const named = query.getAll("origin").map((name) => ({ name, origin: originOf(name) }));
  return {
    origins: [...new Set([own, ...named.flatMap(({ origin }) => origin ?? [])])],
    problems: named.flatMap(({ name, origin }) =>
      origin === undefined ? [`The address names ${JSON.stringify(name.slice(0, 60))} as an origin, expected one such as https://example.org`] : [],
    ),
  };
}

/** No wildcards, no paths: an origin is scheme, host and port. */
function originOf(name: string): string | undefined {
  if (!/^https?:\/\/[^/?#@*]+\/?$/i.test(name) || !URL.canParse(name)) return undefined;
  return new URL(name).origin;
}
