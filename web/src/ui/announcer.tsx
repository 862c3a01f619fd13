/** Tells readers of the screen what was made, once it is made and no more often than they can say it. */

import { createEffect, createSignal, onCleanup } from "solid-js";
import { useModel, useScale } from "./model";
import { hintText, summaryOf } from "./words";

/** After the last change. */
const QUIET_MS = 1500;

export function Announcer() {
  const { facts, viewer } = useModel();
  const scale = useScale();
  const [text, setText] = createSignal("");
  createEffect(() => {
    const { busy, levelTriangles } = facts();
    const triangles = levelTriangles.reduce((sum, n) => sum + n, 0);
    const now = viewer();
    if (busy) return;
    const { parts, activity } = summaryOf(now, triangles, busy, scale());
    const said = activity !== "" ? activity : triangles === 0 ? hintText(now, busy) : parts.join(", ");
    const timer = setTimeout(() => setText(said), QUIET_MS);
    onCleanup(() => clearTimeout(timer));
  });
  return (
    <p class="unseen" role="status">
      {text()}
    </p>
  );
}
