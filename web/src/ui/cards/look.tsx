/** How the surface is shown: changes nothing on the server. */

import { For, lazy, Show, Suspense } from "solid-js";
import { COLOR_MAPS } from "../../colors/maps";
import { MAPS, MATERIALS, type ColorBy, type Look } from "../../state/look";
import { awaitedErrors, errorsOf, shownErrors } from "../../state/shownErrors";
import { useModel, useScale } from "../model";
import { surfaceName } from "../surfaceNames";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";
import { awaitedWords, distanceWords } from "../words";
import type { Card } from "./card";
import { bestField, NO_FEATURE } from "./features";
import { Peel } from "./peel";

const COLORS: readonly { readonly value: ColorBy; readonly text: string; readonly hint: string }[] = [
  { value: "material", text: "Material", hint: "Single colour" },
  { value: "transfer", text: "Transfer", hint: "The colours of the transfer function under Importance" },
  { value: "feature", text: "Input", hint: "The input of the transfer function: shape and field, blended" },
  { value: "field", text: "Field", hint: "A field in its units: that under Importance, or any other" },
  { value: "importance", text: "Importance", hint: "How much each part matters" },
  { value: "level", text: "Level", hint: "How large the cubes are that triangles stand for" },
  { value: "error", text: "Error", hint: "How far each vertex is from the isosurface, measured" },
];

const FieldColors = lazy(() => import("./fieldColorRows"));

const BACKGROUNDS: readonly { readonly value: Look["background"]; readonly text: string }[] = [
  { value: "page", text: "Page" },
  { value: "black", text: "Black" },
  { value: "white", text: "White" },
];

const capitalised = (name: string) => `${name.charAt(0).toUpperCase()}${name.slice(1)}`;

function Body() {
  const { actions, look, onGpu, selected, surfaces } = useModel();
  const materials = MATERIALS.map((name) => ({ value: name, text: capitalised(name) }));
  const mapped = () => ["feature", "field", "importance"].includes(look().colorBy);
  return (
    <>
      <ColorChoice />
      <Show when={mapped()}>
        <Maps />
      </Show>
      <Show when={look().colorBy === "field"}>
        <Suspense>
          <FieldColors />
        </Suspense>
      </Show>
      <Show when={look().colorBy === "error"}>
        <ErrorNote />
      </Show>
      <Show when={selected()?.style.color !== undefined}>
        <div class="control row">
          <p class="note">{capitalised(surfaceName(surfaces(), selected()?.number) || "the surface")} has a colour of its own</p>
          <Button quiet onClick={() => actions.changeStyle(selected()?.number ?? 0, { color: undefined })}>
            Use these
          </Button>
        </div>
      </Show>
      <div class="control">
        <span class="label">Material</span>
        <Choice<Look["material"]> label="Material" wide value={look().material} options={materials} onChange={(material) => actions.changeLook({ material })} />
      </div>
      <div class="switches">
        <Toggle label="Flat triangles" on={look().flat} onChange={(flat) => actions.changeLook({ flat })} />
        <Toggle label="Wireframe" on={look().wireframe} onChange={(wireframe) => actions.changeLook({ wireframe })} />
        <Show when={onGpu}>
          <Toggle label="Occlusion" on={look().occlusion} onChange={(occlusion) => actions.changeLook({ occlusion })} />
          <Toggle label="Silhouettes" on={look().silhouettes} onChange={(silhouettes) => actions.changeLook({ silhouettes })} />
        </Show>
      </div>
      <Peel />
      <div class="control row">
        <span class="label">Background</span>
        <Choice<Look["background"]> label="Background" value={look().background} options={BACKGROUNDS} onChange={(background) => actions.changeLook({ background })} />
      </div>
    </>
  );
}

/** What colours stand for. */
function ColorChoice() {
  const model = useModel();
  const { actions, look, view, viewer, volume } = model;
  const hasField = () => view()?.colorField !== null || (view()?.feature ?? NO_FEATURE) !== NO_FEATURE;
  const isOffered = (by: ColorBy) => {
    if (by === "error") return viewer().questions.includes("annotate");
    return by !== "field" || hasField() || model.may("edit");
  };
  const choose = (colorBy: ColorBy) => {
    const [of, shown] = [volume(), view()];
    // Without a field under Importance there is none yet.
    if (colorBy === "field" && !hasField() && of !== undefined && shown !== undefined) actions.edit({ colorField: bestField(of, shown.field) });
    actions.changeLook({ colorBy });
  };
  const colors = () => COLORS.filter(({ value }) => value === look().colorBy || isOffered(value));
  return (
    <div class="control">
      <span class="label">Colour by</span>
      <Choice<ColorBy> label="Colour by" wide value={look().colorBy} options={colors()} onChange={choose} />
    </div>
  );
}

/** What the colours of the error mean, or why there are none yet. */
function ErrorNote() {
  const { surfaces, viewer } = useModel();
  const scale = useScale();
  const text = () => {
    const distances = shownErrors(viewer(), surfaces());
    return distances === undefined ? awaitedWords(awaitedErrors(viewer(), surfaces())) : distanceWords(distances, errorsOf(viewer(), surfaces()), scale());
  };
  return <p class="note">{text()}</p>;
}

/** The colour maps as what they look like. */
function Maps() {
  const { actions, look } = useModel();
  return (
    <div class="maps" role="group" aria-label="Colour map">
      <For each={MAPS}>
        {(map) => (
          <button type="button" class="map" aria-label={map} title={map} aria-pressed={look().map === map} on:click={() => actions.changeLook({ map })}>
            <i style={{ background: `linear-gradient(to right, ${COLOR_MAPS[map].join(", ")})` }} />
          </button>
        )}
      </For>
    </div>
  );
}

export const lookCard: Card = { id: "look", title: "Look", icon: "look", body: Body };
