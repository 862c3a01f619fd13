/** A text field for a number. The value changes on Enter or when the field loses focus; Escape restores it. What is not taken is said. */

import { createEffect, createSignal, on } from "solid-js";
import { formatValue, parseValue } from "../format";
import { useModel } from "../model";

export interface NumberFieldProps {
  readonly label: string;
  /** NaN: nothing is shown. */
  readonly value: number;
  readonly min?: number;
  readonly max?: number;
  /** Arrow keys change by this much; Shift by ten times. */
  readonly step?: number;
  readonly disabled?: boolean;
  readonly wide?: boolean;
  /** Digits that are shown. */
  readonly digits?: number;
  readonly onChange: (value: number) => void;
}

/** Why a text is not taken as it is; `undefined` where it is. `taken`: what takes its place. */
export function refusedText(text: string, { label, min = -Infinity, max = Infinity }: Pick<NumberFieldProps, "label" | "min" | "max">, taken: number): string | undefined {
  const typed = parseValue(text);
  if (typed === undefined) return text.trim() === "" ? undefined : `“${text.trim()}” is no number: ${label} stays ${formatValue(taken)}`;
  if (typed < min) return `${label} is at least ${formatValue(min)}: ${formatValue(taken)} is taken`;
  return typed > max ? `${label} is at most ${formatValue(max)}: ${formatValue(taken)} is taken` : undefined;
}

/** What an arrow key adds; `undefined` for other keys. */
function stepOf({ key, shiftKey }: KeyboardEvent, step = 1): number | undefined {
  if (key !== "ArrowUp" && key !== "ArrowDown") return undefined;
  return (key === "ArrowUp" ? step : -step) * (shiftKey ? 10 : 1);
}

export function NumberField(props: NumberFieldProps) {
  const { say } = useModel();
  const format = (value: number) => formatValue(value, props.digits);
  const [text, setText] = createSignal(format(props.value));
  const [isTyping, setTyping] = createSignal(false);
  const clamp = (value: number) => Math.min(props.max ?? Infinity, Math.max(props.min ?? -Infinity, value));
  const show = () => {
    setTyping(false);
    setText(format(props.value));
  };
  // The user's unfinished text is not overwritten.
  createEffect(on(() => props.value, () => isTyping() || show(), { defer: true }));
  const accept = (value: number) => {
    const rounded = Number(formatValue(value, Math.max(7, props.digits ?? 0)));
    setTyping(false);
    setText(format(rounded));
    if (rounded !== props.value) props.onChange(rounded);
  };
  const commit = () => {
    const typed = parseValue(text());
    // A value out of bounds becomes the bound; text that is no number is replaced by the value before.
    if (isTyping()) say(refusedText(text(), props, typed === undefined ? props.value : clamp(typed)));
    if (!isTyping() || typed === undefined || text() === format(props.value)) show();
    else accept(clamp(typed));
  };
  const invalid = () => isTyping() && parseValue(text()) !== clamp(parseValue(text()) ?? NaN);
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Escape" && isTyping()) {
      event.stopPropagation();
      show();
    }
    if (event.key === "Enter") commit();
    const step = stepOf(event, props.step);
    if (step === undefined) return;
    event.preventDefault();
    const value = parseValue(text()) ?? props.value;
    if (Number.isFinite(value)) accept(clamp(value + step));
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
      on:input={(event) => {
        setTyping(true);
        setText(event.currentTarget.value);
      }}
      on:change={commit}
      on:blur={commit}
      on:focus={(event) => event.currentTarget.select()}
      on:keydown={onKeyDown}
    />
  );
}
