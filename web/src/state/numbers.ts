/** Numbers of a link. Pure. */

/** As few digits as the server, which computes with 32 bits, needs to read the same number. */
export function digits(n: number): string {
  const same = [7, 8].map((count) => Number(n.toPrecision(count))).find((short) => Math.fround(short) === Math.fround(n));
  return String(same ?? Number(n.toPrecision(9)));
}

export const list = (numbers: readonly number[]) => numbers.map(digits).join(",");
