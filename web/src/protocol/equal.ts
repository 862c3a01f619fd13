/**
 * Whether two values are equal: numbers, texts, or arrays and objects of such. A field that is `undefined` counts as absent. Parts that both
 * share are not looked into.
 */
export function isEqual(a: unknown, b: unknown): boolean {
  if (a === b) return true;
  if (typeof a !== "object" || typeof b !== "object" || a === null || b === null) return false;
  const [one, other] = [a as Record<string, unknown>, b as Record<string, unknown>];
  return Array.isArray(a) === Array.isArray(b) && Object.keys({ ...one, ...other }).every((name) => isEqual(one[name], other[name]));
}
