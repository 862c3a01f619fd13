/** A text field for a number. The value changes on Enter or when the field loses focus; Escape restores it. */

import { createEffect, createSignal, on } from "solid-js";
import { formatValue, parseValue } from "../format";

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
  readonly onChange: (value: number) => void;
}

export function NumberField(props: NumberFieldProps) {
  const [text, setText] = createSignal(formatValue(props.value));
  const [isTyping, setTyping] = createSignal(false);
  const clamp = (value: number) => Math.min(props.max ?? Infinity, Math.max(props.min ?? -Infinity, value));
  const show = () => {
    setTyping(false);
    setText(formatValue(props.value));
  };
  // The user's unfinished text is not overwritten.
  const follow = () => isTyping() || show();
  createEffect(on(() => props.value, follow, { defer: true }));
  const accept = (value: number) => {
    const rounded = Number(formatValue(value, 7));
    setTyping(false);
    setText(formatValue(rounded));
    if (rounded !== props.value) props.onChange(rounded);
  };
  const commit = () => {
    const typed = parseValue(text());
    // A value out of bounds becomes the bound; text that is no number is replaced by the value before.
    if (!isTyping() || typed === undefined || text() === formatValue(props.value)) show();
    else accept(clamp(typed));
  };
  const invalid = () => {
    const value = parseValue(text());
    return isTyping() && (value === undefined || value !== clamp(value));
  };
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Escape" && isTyping()) {
      event.stopPropagation();
      show();
    }
    if (event.key === "Enter") commit();
    if (event.key !== "ArrowUp" && event.key !== "ArrowDown") return;
    event.preventDefault();
    const step = (props.step ?? 1) * (event.shiftKey ? 10 : 1);
    const value = parseValue(text()) ?? props.value;
    if (Number.isFinite(value)) accept(clamp(value + (event.key === "ArrowUp" ? step : -step)));
  };
  return (
    <input
      class="number"
      classList={{ invalid: invalid(), wide: props.wide ?? false }}
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
