/** Tells readers of the screen what was made, once it is made and no more often than they can say it. */

import { createEffect, createSignal, onCleanup } from "solid-js";
import { useModel, useScale } from "./model";
import { isFollowingCamera } from "../state/viewer";
import { hintText, summaryOf } from "./words";

/** After the last change. */
const QUIET_MS = 1500;

export function Announcer() {
  const { facts, viewer } = useModel();
  const scale = useScale();
  const [text, setText] = createSignal("");
  /** Generations of the edits whose surfaces were announced. */
  let announced = "";
  createEffect(() => {
    const { busy, levelTriangles } = facts();
    const triangles = levelTriangles.reduce((sum, n) => sum + n, 0);
    const now = viewer();
    const edited = [...now.known.values()].map((one) => one.edited).join();
    // Not for each move of the camera.
    if (busy || (edited === announced && isFollowingCamera(now) && now.connection === "connected")) return;
    const { parts, activity } = summaryOf(now, triangles, busy, scale());
    const said = activity !== "" ? activity : triangles === 0 ? hintText(now, busy) : parts.join(", ");
    const timer = setTimeout(() => {
      announced = edited;
      setText(said);
    }, QUIET_MS);
    onCleanup(() => clearTimeout(timer));
  });
  return (
    <p class="unseen" role="status">
      {text()}
    </p>
  );
}
