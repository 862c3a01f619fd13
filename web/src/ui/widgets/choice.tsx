/** One of a few choices, as a row of buttons, and one of a list. */

import { RadioGroup } from "@kobalte/core/radio-group";
import { Switch } from "@kobalte/core/switch";
import { createUniqueId, For, Show } from "solid-js";

export interface Option<T extends string | number> {
  readonly value: T;
  readonly text: string;
  readonly hint?: string;
}

export function Choice<T extends string | number>(props: {
  readonly label: string;
  readonly value: T | undefined;
  readonly options: readonly Option<T>[];
  /** As wide as the card. */
  readonly wide?: boolean;
  readonly onChange: (value: T) => void;
}) {
  const choose = (text: string) => {
    const option = props.options.find(({ value }) => String(value) === text);
    if (option !== undefined && option.value !== props.value) props.onChange(option.value);
  };
  return (
    <RadioGroup class={props.wide === true ? "choice wide" : "choice"} aria-label={props.label} value={String(props.value ?? "")} onChange={choose}>
      <For each={props.options}>
        {(option) => (
          <RadioGroup.Item class="choice-item" value={String(option.value)} title={option.hint}>
            <RadioGroup.ItemInput class="choice-input" />
            <RadioGroup.ItemLabel class="choice-label">{option.text}</RadioGroup.ItemLabel>
          </RadioGroup.Item>
        )}
      </For>
    </RadioGroup>
  );
}

/** The browser's own list: on a phone it is the phone's. */
export function Select(props: {
  readonly label: string;
  readonly hideLabel?: boolean;
  readonly value: string | undefined;
  readonly options: readonly Option<string>[];
  readonly onChange: (value: string) => void;
}) {
  const id = createUniqueId();
  return (
    <div class="control row select">
      <Show when={props.hideLabel !== true}>
        <label for={id}>{props.label}</label>
      </Show>
      <select
        id={id}
        aria-label={props.hideLabel === true ? props.label : undefined}
        // With one entry there is nothing to choose.
        disabled={props.options.length < 2}
        on:change={(event) => props.onChange(event.currentTarget.value)}
      >
        <For each={props.options}>
          {(option) => (
            <option value={option.value} selected={option.value === props.value}>
              {option.text}
            </option>
          )}
        </For>
      </select>
    </div>
  );
}

export function Toggle(props: { readonly label: string; readonly on: boolean; readonly onChange: (on: boolean) => void }) {
  return (
    <Switch class="toggle" checked={props.on} onChange={props.onChange}>
      <Switch.Input class="toggle-input" />
      <Switch.Label>{props.label}</Switch.Label>
      <Switch.Control class="toggle-track">
        <Switch.Thumb class="toggle-thumb" />
      </Switch.Control>
    </Switch>
  );
}
