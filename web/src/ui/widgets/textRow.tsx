/** A field for a text, with its name before it. */

import { createUniqueId } from "solid-js";

interface TextRowProps {
  readonly label: string;
  readonly value: string;
  readonly placeholder?: string;
  readonly maxLength?: number;
  readonly isInvalid?: boolean;
  /** With every character. */
  readonly onInput?: (value: string) => void;
  /** On Enter, or when the field loses focus. */
  readonly onChange?: (value: string) => void;
}

export function TextRow(props: TextRowProps) {
  const id = createUniqueId();
  return (
    <div class="control row">
      <label for={id}>{props.label}</label>
      <input
        id={id}
        class="text"
        classList={{ invalid: props.isInvalid }}
        type="text"
        autocomplete="off"
        aria-invalid={props.isInvalid}
        maxlength={props.maxLength}
        placeholder={props.placeholder}
        value={props.value}
        on:input={(event) => props.onInput?.(event.currentTarget.value)}
        on:change={(event) => props.onChange?.(event.currentTarget.value)}
      />
    </div>
  );
}
