/** Messages to the user, in a corner of the picture. */

import { For, Show } from "solid-js";
import { useModel } from "./model";
import { Button } from "./widgets/button";

export function Toasts() {
  const model = useModel();
  return (
    <div class="toasts" role="alert">
      <For each={model.toasts()}>
        {(toast) => (
          <div class="toast" classList={{ good: toast.good }}>
            <p>{toast.text}</p>
            <Show when={toast.retry}>
              {(retry) => (
                <Button quiet onClick={retry()}>
                  Try again
                </Button>
              )}
            </Show>
            <For each={toast.answers ?? []}>
              {({ text, act }) => (
                <Button quiet onClick={act}>
                  {text}
                </Button>
              )}
            </For>
            <Button quiet onClick={() => model.dismiss(toast.text)}>
              Dismiss
            </Button>
          </div>
        )}
      </For>
    </div>
  );
}
