/** A field for a text that is checked. The value changes on Enter or when the field loses focus; Escape restores it. What is not taken is said, and stays to be mended. */

import { createEffect, createSignal, on } from "solid-js";
import { useModel } from "../model";

interface TextFieldProps {
  readonly label: string;
  readonly value: string;
  readonly placeholder?: string;
  /** Explains why a text is not accepted; `undefined` if it is. */
  readonly refused: (text: string) => string | undefined;
  readonly onChange: (value: string) => void;
}

export function TextField(props: TextFieldProps) {
  const { say } = useModel();
  /** It is said once, and again if Enter is pressed. */
  let said = "";
  const [text, setText] = createSignal(props.value);
  const show = () => setText(props.value);
  createEffect(on(() => props.value, show, { defer: true }));
  const commit = (isAsked: boolean) => {
    const typed = text().trim();
    if (typed === props.value) return;
    const refused = props.refused(typed);
    if (isAsked || said !== typed) say(refused);
    said = typed;
    if (refused === undefined) props.onChange(typed);
  };
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Enter") commit(true);
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
      on:change={() => commit(false)}
      on:blur={() => commit(false)}
      on:keydown={onKeyDown}
    />
  );
}
