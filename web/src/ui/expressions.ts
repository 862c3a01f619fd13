/** What is known of expressions that are in force or typed: asked once for each text, volume and step. */

import { createResource, type Accessor } from "solid-js";
import { describeExpression } from "../net/expressions";
import type { FieldInfo } from "../protocol/types";
import { faultOf, type Fault } from "../state/expressions";
import { useModel } from "./model";

/** Of a text: what it gives, or what is wrong with it. */
interface Described {
  readonly text: string;
  readonly info?: FieldInfo;
  readonly fault?: Fault;
}

/** As many as a session with some typing uses; the oldest goes. */
const MAX_KEPT = 64;
const kept = new Map<string, Promise<Described>>();

async function ask(volume: string, step: number, text: string): Promise<Described> {
  try {
    return { text, info: await describeExpression(new URL(".", window.location.href), volume, step, text) };
  } catch (error) {
    return { text, fault: faultOf(error instanceof Error ? error.message : String(error)) };
  }
}

function described([volume, step, text]: readonly [string, number, string]): Promise<Described> {
  const key = JSON.stringify([volume, step, text]);
  const known = kept.get(key) ?? ask(volume, step, text);
  kept.delete(key);
  kept.set(key, known);
  // What failed may be there the next time: a busy server, say.
  void known.then(({ fault }) => fault !== undefined && kept.delete(key));
  const [oldest] = kept.keys();
  if (kept.size > MAX_KEPT && oldest !== undefined) kept.delete(oldest);
  return known;
}

/**
 * Describes an expression over the open volume at its step; `text` is undefined if nothing is asked. The last answer stays until the next
 * one is there.
 */
export function useDescribed(text: Accessor<string | undefined>): Accessor<Described | undefined> {
  const { volume } = useModel();
  const asked = () => {
    const [open, expression] = [volume(), text()];
    return open === undefined || expression === undefined ? undefined : ([open.id, open.step, expression] as const);
  };
  const [answer] = createResource(asked, described);
  return () => (asked() === undefined ? undefined : answer.latest);
}
