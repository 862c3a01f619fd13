/** Two surfaces side by side, with a line between them that can be dragged. */

import { Match, Show, Switch } from "solid-js";
import { useModel } from "../model";
import { Needs } from "../needs";
import { Button } from "../widgets/button";

export default function Body() {
  const { actions, comparing } = useModel();
  const stop = () => <Button onClick={() => actions.compare(undefined)}>Stop</Button>;
  return (
    <Switch fallback={<Choices />}>
      <Match when={comparing() === "waiting"}>
        <div class="control row">
          <p class="note">The full surface is on its way</p>
          {stop()}
        </div>
      </Match>
      <Match when={comparing() === "full"}>
        <div class="control row">
          <p class="note">The full surface is on the left. Drag the line, or move it with arrow keys; Detail changes the right</p>
          {stop()}
        </div>
      </Match>
      <Match when={comparing() === "importance"}>
        <div class="control row">
          <p class="note">As many triangles, with importance on the left and without on the right. Drag the line</p>
          {stop()}
        </div>
      </Match>
      <Match when={comparing() === "edit"}>
        <div class="control row">
          <p class="note">What was kept is on the left. Whatever you change now is on the right of the line</p>
          {stop()}
        </div>
      </Match>
    </Switch>
  );
}

function Choices() {
  const { actions, look, viewer } = useModel();
  const isOffered = () => viewer().questions.includes("annotate") && look().colorBy !== "error";
  return (
    <>
      <Needs role="edit">
        <div class="control row">
          <span class="note">What does decimation cost?</span>
          <Button onClick={() => actions.compare("full")}>Against full</Button>
        </div>
        <div class="control row">
          <span class="note">What does importance bring?</span>
          <Button onClick={() => actions.compare("importance")}>Same budget without</Button>
        </div>
        <div class="control row">
          <span class="note">What does the next edit change?</span>
          <Button onClick={() => actions.compare("edit")}>Keep this</Button>
        </div>
      </Needs>
      <Show when={isOffered()}>
        <div class="control row">
          <span class="note">Where is it off, and how far?</span>
          <Button onClick={() => actions.changeLook({ colorBy: "error" })}>Colour by error</Button>
        </div>
      </Show>
    </>
  );
}
