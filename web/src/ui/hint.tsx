/** What stands in the middle of the picture while there is no surface, or while another volume is being opened. */

import { Show } from "solid-js";
import { formatPercent } from "./format";
import { useModel } from "./model";
import { hintText } from "./words";

export function Hint() {
  const { facts, surfaces, viewer } = useModel();
  const text = () => {
    const state = viewer();
    // Another step of the volume mostly comes at once: the surface of the one before stays in sight.
    const isAnother = state.openedShare !== undefined && state.target?.volume !== state.volume?.id;
    const isEmpty = facts().levelTriangles.every((n) => n === 0);
    if (!isEmpty && !isAnother && surfaces().every(({ style }) => !style.visible || style.opacity === 0)) return "What is there is hidden or transparent: show it with its eye or its opacity under Surface";
    return isEmpty || isAnother ? hintText(state, facts().busy) : "";
  };
  return (
    <Show when={text()}>
      {(shown) => (
        <div class="hint">
          <span>{shown()}</span>
          <Show when={viewer().openedShare !== undefined}>
            <progress max={1} value={viewer().openedShare ?? 0} aria-label="Progress" />
            <span class="amount">{formatPercent(viewer().openedShare ?? 0)}</span>
          </Show>
        </div>
      )}
    </Show>
  );
}
