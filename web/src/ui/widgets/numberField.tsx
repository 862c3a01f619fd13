/** A text field for a number. The value changes on Enter or when the field loses focus; Escape restores it. What is not taken is said. */

import { createEffect, createSignal, on } from "solid-js";
import { readTyped, type NumberKind, type TypedNumber } from "../../state/typedNumber";
import { formatValue } from "../format";
import { useModel } from "../model";

export interface NumberFieldProps extends NumberKind {
  readonly label: string;
  /** NaN: nothing is shown. */
  readonly value: number;
  /** Arrow keys change by this much; Shift by ten times. */
  readonly step?: number;
  readonly disabled?: boolean;
  readonly wide?: boolean;
  /** Digits that are shown. */
  readonly digits?: number;
  /** Takes a typed text that means more than a number. Returns whether it has done so. */
  readonly acceptText?: (text: string) => boolean;
  readonly onChange: (value: number) => void;
}

type Bounds = Pick<NumberKind, "min" | "max">;

/** Explains why a text is not accepted as it is; `undefined` if it is accepted. `taken`: the value used instead. */
export function refusedText(text: string, kind: NumberKind & { readonly label: string }, taken: number): string | undefined {
  const { label, min = -Infinity, max = Infinity } = kind;
  const typed = readTyped(text, kind);
  if (typed === undefined) return text.trim() === "" ? undefined : `“${text.trim()}” is not a number: ${label} stays ${formatValue(taken)}`;
  if (typeof typed !== "number") return undefined;
  if (typed < min) return `${label}: the minimum is ${formatValue(min)}`;
  return typed > max ? `${label}: the maximum is ${formatValue(max)}` : undefined;
}

function clamp(value: number, { min = -Infinity, max = Infinity }: Bounds): number {
  return Math.min(max, Math.max(min, value));
}

/** What an arrow key adds; `undefined` for other keys. */
function stepOf({ key, shiftKey }: KeyboardEvent, step = 1): number | undefined {
  if (key !== "ArrowUp" && key !== "ArrowDown") return undefined;
  return (key === "ArrowUp" ? step : -step) * (shiftKey ? 10 : 1);
}

/** What is typed into a field, and what becomes of it. */
function useTyping(props: NumberFieldProps) {
  const { ask, say } = useModel();
  const format = (value: number) => formatValue(value, props.digits);
  const [text, setText] = createSignal(format(props.value));
  const [isTyping, setTyping] = createSignal(false);
  const typed = () => readTyped(text(), props);
  const show = () => {
    setTyping(false);
    setText(format(props.value));
  };
  // The user's unfinished text is not overwritten.
  createEffect(on(() => props.value, () => isTyping() || show(), { defer: true }));
  const accept = (value: number) => {
    const rounded = Number(formatValue(clamp(value, props), Math.max(7, props.digits ?? 0)));
    setTyping(false);
    setText(format(rounded));
    if (rounded !== props.value) props.onChange(rounded);
  };
  /** Text that is no number is replaced by the value before, and so is text that can be read in two ways until the user says which is meant. */
  const commitTyped = (text: string, value: TypedNumber) => {
    if (typeof value === "number") accept(value);
    else show();
    if (typeof value === "object") ask(`“${text.trim()}” can be read in two ways. Which is ${props.label}?`, value.map((number) => ({ text: formatValue(number, 9), act: () => accept(number) })));
  };
  const commit = () => {
    const value = typed();
    if (!isTyping() || text() === format(props.value) || props.acceptText?.(text()) === true) return show();
    say(refusedText(text(), props, typeof value === "number" ? clamp(value, props) : props.value));
    commitTyped(text(), value);
  };
  const invalid = () => {
    const value = typed();
    return isTyping() && (value === undefined || (typeof value === "number" && value !== clamp(value, props)));
  };
  const type = (changed: string) => {
    setTyping(true);
    setText(changed);
  };
  return { text, typed, isTyping, invalid, type, accept, commit, show };
}

export function NumberField(props: NumberFieldProps) {
  const { text, typed, isTyping, invalid, type, accept, commit, show } = useTyping(props);
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Escape" && isTyping()) {
      event.stopPropagation();
      show();
    }
    if (event.key === "Enter") commit();
    const step = stepOf(event, props.step);
    if (step === undefined) return;
    event.preventDefault();
    const value = typed();
    const from = typeof value === "number" ? value : props.value;
    if (Number.isFinite(from)) accept(from + step);
  };
  return (
    <input
      class="number"
      classList={{ invalid: invalid(), wide: props.wide ?? false }}
      style={{ "--characters": String(text().length) }}
      type="text"
      inputmode="decimal"
      autocomplete="off"
      spellcheck={false}
      aria-label={props.label}
      aria-invalid={invalid()}
      disabled={props.disabled ?? false}
      value={text()}
      on:input={(event) => type(event.currentTarget.value)}
      on:change={commit}
      on:blur={commit}
      on:focus={(event) => event.currentTarget.select()}
      on:keydown={onKeyDown}
    />
  );
}
