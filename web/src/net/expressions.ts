/** Description of the field that an expression over a volume's fields gives. Normative: `GET /api/v1/volumes/{id}/expression` in `/api/v1/openapi.json`. */

import type { FieldInfo } from "../protocol/types";
import { ask } from "./rest";

/** @throws with what is wrong with it, and at which character */
export async function describeExpression(base: URL, volume: string, step: number, expression: string): Promise<FieldInfo> {
  const url = new URL(`api/v1/volumes/${encodeURIComponent(volume)}/expression`, base);
  url.searchParams.set("expression", expression);
  url.searchParams.set("step", String(step));
  // While the user types, mistakes are normal, and not errors of the page.
  url.searchParams.set("typed", "true");
  const response = await ask(url, { headers: { accept: "application/json" } });
  return (await response.json()) as FieldInfo;
}
