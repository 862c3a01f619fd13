/** The named values of a link, read and checked. Pure. */

/** What was wrong with a link, for the user. */
export class LinkError extends Error {
  override readonly name = "LinkError";
}

export class Reader {
  /** @param prefix of the names in the link, which `values` are without */
  constructor(
    private readonly values: ReadonlyMap<string, string>,
    private readonly prefix = "",
  ) {}

  /** A name as it is in the link. */
  named(name: string): string {
    return this.prefix + name;
  }

  text(name: string): string | undefined {
    return this.values.get(name);
  }

  number(name: string): number | undefined {
    const text = this.values.get(name);
    return text === undefined ? undefined : toNumber(this.named(name), text);
  }

  flag(name: string): boolean | undefined {
    const text = this.values.get(name);
    if (text !== undefined && text !== "0" && text !== "1") throw new LinkError(`This link's “${this.named(name)}” is ${JSON.stringify(text)}, expected 0 or 1`);
    return text === undefined ? undefined : text === "1";
  }

  numbers(name: string, count: number): number[] | undefined {
    const text = this.values.get(name);
    return text === undefined ? undefined : toNumbers(this.named(name), text, [count]);
  }

  /** A distance is a number of world units, or text that the server reads. */
  distance(name: string): number | string | undefined {
    const text = this.values.get(name);
    if (text === undefined || !/^[+-]?[\d.]+(e[+-]?\d+)?$/i.test(text)) return text;
    return toNumber(this.named(name), text);
  }

  list<T>(name: string, read: (text: string, name: string) => T): T[] | undefined {
    const text = this.values.get(name);
    if (text === undefined) return undefined;
    return text === "" ? [] : text.split(";").map((part) => read(part, this.named(name)));
  }
}

export function toNumber(name: string, text: string): number {
  const value = Number(text);
  if (text.trim() === "" || !Number.isFinite(value)) throw new LinkError(`This link's “${name}” is ${JSON.stringify(text)}, expected a number`);
  return value;
}

export function toNumbers(name: string, text: string, counts: readonly number[]): number[] {
  const parts = text.split(",");
  if (!counts.includes(parts.length)) throw new LinkError(`This link's “${name}” has ${parts.length} numbers, expected ${counts.join(" or ")}`);
  return parts.map((part) => toNumber(name, part));
}
