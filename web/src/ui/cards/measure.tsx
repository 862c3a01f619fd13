/** Distances, angles and readings at points that are picked on the surface. */

import { For, Show } from "solid-js";
import { volumeName } from "../../state/fileNames";
import { unitWord } from "../../state/lengths";
import { MAX_LABEL, MAX_MEASURES, measuresCsv, POINTS, type MeasureKind } from "../../state/measure";
import { useModel, useScale } from "../model";
import { saveFile } from "../takeAlong";
import { Button } from "../widgets/button";
import { Icon } from "../widgets/icon";
import { measureWords } from "./measureWords";
import { Tools } from "./tools";

const TOOLS: readonly { readonly tool: MeasureKind; readonly text: string }[] = [
  { tool: "distance", text: "Distance" },
  { tool: "angle", text: "Angle" },
  { tool: "reading", text: "Values" },
  { tool: "label", text: "Label" },
];

/** What to click, point by point. */
const STEPS: Readonly<Record<MeasureKind, readonly string[]>> = {
  distance: ["Click one end on the surface", "Click the other end"],
  angle: ["Click the end of one side", "Click the corner", "Click the end of the other side"],
  reading: ["Click the place whose values you want"],
  label: ["Click the place that gets a label"],
};

export default function Body() {
  const { look, page, viewer } = useModel();
  return (
    <>
      <Tools
        label="What to measure"
        tools={TOOLS}
        isOffered={(tool) => tool !== "reading" || viewer().questions.includes("probe")}
        hint={(tool) => <span role="status">{STEPS[tool][page().picked.length % POINTS[tool]]}</span>}
      />
      <Show when={look().measures.length > 0} fallback={<p class="note">Straight-line distance between points on the surface</p>}>
        <List />
      </Show>
    </>
  );
}

function List() {
  const { actions, look, volume } = useModel();
  const scale = useScale();
  const measures = () => look().measures;
  const rename = (at: number, text: string) => actions.changeLook({ measures: measures().map((one, i) => (i === at && one.kind === "label" ? { ...one, text } : one)) });
  const save = () => {
    const now = volume();
    if (now !== undefined) saveFile(`${volumeName(now)}-measurements.csv`, new Blob([measuresCsv(measures(), now)], { type: "text/csv" }));
  };
  return (
    <>
      <ol class="regions measures" aria-live="polite">
        <For each={measures()}>
          {(measure, index) => (
            <li>
              <Show when={measure.kind === "label"} fallback={<span>{index() + 1} · {measureWords(measure, volume(), scale())}</span>}>
                <input class="text" type="text" aria-label={`Text of label ${index() + 1}`} maxlength={MAX_LABEL} value={measureWords(measure, volume(), scale())} on:change={(event) => rename(index(), event.currentTarget.value)} />
              </Show>
              <button type="button" class="icon-button" aria-label={`Remove measurement ${index() + 1}`} on:click={() => actions.changeLook({ measures: measures().toSpliced(index(), 1) })}>
                <Icon name="close" />
              </button>
            </li>
          )}
        </For>
      </ol>
      <div class="control row">
        <span class="note">{measures().length < MAX_MEASURES ? `In ${unitWord(scale().unit)}` : `${MAX_MEASURES}, as many as there can be`}</span>
        <span class="inline">
          <Button onClick={save}>Save CSV</Button>
          <Button quiet onClick={() => actions.changeLook({ measures: [] })}>
            Remove all
          </Button>
        </span>
      </div>
    </>
  );
}
