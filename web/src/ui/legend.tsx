/** What the colours of levels mean, and why those of the error are not there yet. */

import { For, lazy, Show, Suspense } from "solid-js";
import { awaitedErrors } from "../state/shownErrors";
import { LEVEL_COLORS } from "../transfer/lut";
import { formatCount } from "./format";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import { awaitedWords } from "./words";

const FieldLegend = lazy(() => import("./fieldLegend"));

/** @param editable the range of a field's colours can be changed */
export function Legend(props: { readonly editable?: boolean }) {
  const model = useModel();
  const { actions, comparing, look, surfaces, viewer } = model;
  const may = (role: "edit") => model.may(role);
  const awaited = () => (look().colorBy === "error" ? awaitedWords(awaitedErrors(viewer(), surfaces())) : "");
  return (
    <>
      <Show when={look().colorBy === "level"}>
        <Levels />
      </Show>
      <Suspense>
        <Show when={props.editable === true && look().colorBy === "field"}>
          <FieldLegend />
        </Show>
      </Suspense>
      <Show when={props.editable === true && look().colorBy === "importance" && may("edit")}>
        <div class="without-importance">
          <Button pressed={comparing() === "importance"} onClick={() => actions.compare(comparing() === "importance" ? undefined : "importance")}>
            Same budget without importance
          </Button>
        </div>
      </Show>
      <Show when={awaited()}>{(text) => <p class="display-legend">{text()}</p>}</Show>
    </>
  );
}

function Levels() {
  const { facts } = useModel();
  return (
    <div class="display-legend level-legend">
      <For each={LEVEL_COLORS}>
        {(color, level) => (
          <>
            <i class="swatch" style={{ background: color }} />
            <span>Level {level()}</span>
            <span class="count">{formatCount(facts().levelTriangles[level()] ?? 0)}</span>
          </>
        )}
      </For>
    </div>
  );
}
