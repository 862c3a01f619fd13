/** Expressions over fields, as they are typed. Pure; the server reads them. */

import type { VolumeInfo } from "../protocol/types";

/** What is wrong with an expression, and at which character, counted from 0; without `at` if that is not known. */
export interface Fault {
  readonly why: string;
  readonly at?: number;
}

/** Takes the server's sentence apart: `expression: "log(x)", character 5: no field "x", expected …`. */
export function faultOf(message: string): Fault {
  const [, character, why] = /", character (\d+): (.*)$/s.exec(message) ?? [];
  return character === undefined || why === undefined ? { why: message } : { why, at: Number(character) - 1 };
}

/** The text with a mark below the character at fault, counted as a reader sees them. */
export function pointedAt(text: string, at: number): string {
  const line = text.replaceAll(/\s/gu, " ");
  return `${line}\n${" ".repeat(Math.min(at, Array.from(line).length))}▲`;
}

/** A field's name as an expression has it. */
export const asOperand = (name: string): string => (/^[A-Za-z_][A-Za-z0-9_]*$/.test(name) ? name : `"${name}"`);

/** Puts a word in place of what is selected; the cursor comes behind it, of a function between its parentheses. */
export function inserted(text: string, [from, to]: readonly [number, number], word: string): { readonly text: string; readonly cursor: number } {
  const isFunction = word.endsWith("()");
  const cursor = from + word.length - (isFunction ? 1 : 0);
  return { text: text.slice(0, from) + word + text.slice(to), cursor };
}

/** Whether a field or feature in force is none that the volume's description has. */
export function isExpression(volume: Pick<VolumeInfo, "fields" | "features" | "vectors">, name: string): boolean {
  const derived = volume.fields.flatMap(({ derivedFeatures }) => Object.keys(derivedFeatures));
  const known = [...volume.fields.map((field) => field.name), ...volume.features.map((feature) => feature.name), ...volume.vectors.flatMap(({ features }) => Object.keys(features)), ...derived];
  // Features of vectors can be named whose components the server does not know.
  const isOfVector = /^(vector-magnitude|divergence|vorticity-magnitude|q-criterion|lambda2|helicity)\s*\(/.test(name);
  return name !== "none" && !isOfVector && !known.includes(name);
}
