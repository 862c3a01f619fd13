/** Buttons with words, and buttons with a picture and a tip that says what they do. */

import { Tooltip } from "@kobalte/core/tooltip";
import type { JSX } from "solid-js";
import type { IconName } from "./icon";
import { Icon } from "./icon";

export function Button(props: {
  readonly onClick: () => void;
  readonly quiet?: boolean;
  readonly disabled?: boolean;
  /** It is on or off. */
  readonly pressed?: boolean;
  readonly class?: string;
  /** For those who do not see what stands around it; begins with its words. */
  readonly label?: string;
  readonly children: JSX.Element;
}) {
  return (
    <button type="button" aria-label={props.label} aria-pressed={props.pressed} class={`button ${props.class ?? ""}`} classList={{ quiet: props.quiet ?? false }} disabled={props.disabled ?? false} on:click={() => props.onClick()}>
      {props.children}
    </button>
  );
}

export function IconButton(props: {
  readonly icon: IconName;
  readonly label: string;
  /** Keys that do the same. */
  readonly keys?: string;
  readonly pressed?: boolean | undefined;
  readonly disabled?: boolean;
  readonly class?: string;
  readonly onClick: () => void;
}) {
  return (
    <Tooltip openDelay={500} closeDelay={0} placement="bottom" gutter={6}>
      <Tooltip.Trigger
        class={`icon-button ${props.class ?? ""}`}
        aria-label={props.label}
        aria-pressed={props.pressed}
        aria-disabled={props.disabled ?? false}
        onClick={() => {
          if (props.disabled !== true) props.onClick();
        }}
      >
        <Icon name={props.icon} />
      </Tooltip.Trigger>
      <Tooltip.Portal>
        <Tooltip.Content class="tip">
          {props.label}
          {props.keys === undefined ? "" : ` · ${props.keys}`}
        </Tooltip.Content>
      </Tooltip.Portal>
    </Tooltip>
  );
}
