/** The sentence of the bookmark that a story shows, over the picture, and how to end it. */

import { Show } from "solid-js";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import "./style/telling.css";

export default function Telling() {
  const { actions, page, telling } = useModel();
  return (
    <Show when={telling()}>
      {(told) => (
        <div class="telling">
          <p role="status">{told().text}</p>
          <span class="note">
            {told().index + 1} of {page().story.length}
          </span>
          <Button onClick={() => actions.story({ type: "stop" })}>Stop</Button>
        </div>
      )}
    </Show>
  );
}
