/** Copyright or source of the open volume: two lines, or all of it. */

import { createEffect, createSignal, on, Show } from "solid-js";
import { useModel } from "./model";

export function Notice() {
  const { volume } = useModel();
  const [open, setOpen] = createSignal(false);
  createEffect(on(volume, () => setOpen(false)));
  return (
    <Show when={volume()?.notice}>
      {(text) => (
        <button type="button" class="notice" classList={{ open: open() }} aria-expanded={open()} on:click={() => setOpen(!open())}>
          <span>{text()}</span>
        </button>
      )}
    </Show>
  );
}
