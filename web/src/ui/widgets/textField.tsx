/** A field for a text that is checked. The value changes on Enter or when the field loses focus; Escape restores it. What is not taken is said. */

import { createEffect, createSignal, on } from "solid-js";
import { useModel } from "../model";

interface TextFieldProps {
  readonly label: string;
  readonly value: string;
  readonly placeholder?: string;
  /** Why a text is not taken; `undefined` where it is. */
  readonly refused: (text: string) => string | undefined;
  readonly onChange: (value: string) => void;
}

export function TextField(props: TextFieldProps) {
  const { say } = useModel();
  const [text, setText] = createSignal(props.value);
  const show = () => setText(props.value);
  createEffect(on(() => props.value, show, { defer: true }));
  const commit = () => {
    const typed = text().trim();
    if (typed === props.value) return;
    const refused = props.refused(typed);
    say(refused);
    if (refused === undefined) props.onChange(typed);
    else show();
  };
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Enter") commit();
    if (event.key !== "Escape" || text() === props.value) return;
    event.stopPropagation();
    show();
  };
  const isInvalid = () => props.refused(text()) !== undefined;
  return (
    <input
      class="number wide"
      classList={{ invalid: isInvalid() }}
      type="text"
      autocomplete="off"
      spellcheck={false}
      aria-label={props.label}
      aria-invalid={isInvalid()}
      placeholder={props.placeholder}
      value={text()}
      on:input={(event) => setText(event.currentTarget.value)}
      on:change={commit}
      on:blur={commit}
      on:keydown={onKeyDown}
    />
  );
}
