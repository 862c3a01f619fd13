/** Buttons that put a tool in hand, which a click on the surface uses, and what to do with it. */

import { For, onCleanup, Show, type JSX } from "solid-js";
import type { Tool } from "../../state/page";
import { useModel } from "../model";
import { Button } from "../widgets/button";

interface ToolButton<T extends Tool> {
  readonly tool: T;
  readonly text: string;
  readonly title?: string;
}

interface ToolsProps<T extends Tool> {
  readonly label: string;
  readonly tools: readonly ToolButton<T>[];
  /** Whether there is a button for it. */
  readonly isOffered: (tool: T) => boolean;
  /** What to do with the tool in hand. */
  readonly hint: (tool: T) => JSX.Element;
}

export function Tools<T extends Tool>(props: ToolsProps<T>) {
  const { actions, page } = useModel();
  const inHand = () => props.tools.find(({ tool }) => tool === page().tool)?.tool;
  // Drops the tool: without these buttons the user could not.
  onCleanup(() => {
    if (inHand() !== undefined) actions.changePage({ tool: undefined });
  });
  return (
    <>
      <div class="tools" role="group" aria-label={props.label}>
        <For each={props.tools.filter(({ tool }) => props.isOffered(tool))}>
          {({ tool, text, title }) => (
            <button type="button" class="chip" aria-pressed={page().tool === tool} title={title} on:click={() => actions.changePage({ tool: page().tool === tool ? undefined : tool })}>
              {text}
            </button>
          )}
        </For>
      </div>
      <Show when={inHand()}>
        {(tool) => (
          <div class="tool-hint">
            {props.hint(tool())}
            <Button quiet onClick={actions.useAtCentre}>
              Use the centre
            </Button>
          </div>
        )}
      </Show>
    </>
  );
}
