/** The camera's view of the surface, and the things drawn beside it. */

import { createMemo, For, Show } from "solid-js";
import { EXAGGERATIONS } from "../../state/look";
import { sidesOf, type AxisName } from "../../world/axes";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";

const PROJECTIONS = [
  { value: "perspective", text: "Perspective", hint: "Perspective projection" },
  { value: "orthographic", text: "Orthographic", hint: "Parallel projection: equal lengths look equal, for measuring" },
] as const;
const AXES: readonly AxisName[] = ["+x", "-x", "+y", "-y", "+z", "-z"];
const sign = (axis: string) => axis.replace("-", "−");

export default function Body() {
  const { actions, look, volume } = useModel();
  const sides = createMemo(() => sidesOf(volume()?.geometry.frame));
  return (
    <>
      <div class="control row">
        <span class="label">Camera</span>
        <span class="inline">
          <Button onClick={actions.home}>Home</Button>
          <Button onClick={actions.fit}>Fit</Button>
        </span>
      </div>
      <div class="control row">
        <span class="label">Look from</span>
        <div class="axis-views" role="group" aria-label="Look along an axis">
          <For each={AXES}>
            {(axis) => (
              <button
                type="button"
                class="chip"
                aria-label={`Look from ${[sides()[axis]?.word, sign(axis)].filter(Boolean).join(", ")}`}
                title={sides()[axis] && `From the ${sides()[axis]?.word}`}
                on:click={() => actions.lookFrom(axis)}
              >
                {sides()[axis]?.letter ?? sign(axis)}
              </button>
            )}
          </For>
        </div>
      </div>
      <Choice<string>
        label="Projection"
        wide
        value={look().orthographic ? "orthographic" : "perspective"}
        options={PROJECTIONS}
        onChange={(projection) => actions.changeLook({ orthographic: projection === "orthographic" })}
      />
      <div class="control row">
        <span class="label" title="How many times higher things are shown than they are">Vertical exaggeration</span>
        <span class="inline">
          <NumberField label="Vertical exaggeration" {...EXAGGERATIONS} value={look().exaggeration} onChange={(exaggeration) => actions.changeLook({ exaggeration })} />×
        </span>
      </div>
      <Show when={look().exaggeration !== 1}>
        <p class="note">Lengths, areas and volumes that are measured stay the true ones</p>
      </Show>
      <div class="switches">
        <Toggle label="Bounding box" on={look().box} onChange={(box) => actions.changeLook({ box })} />
        <Toggle label="Scale bar" on={look().scale} onChange={(scale) => actions.changeLook({ scale })} />
        <Toggle label="Axes cube" on={look().axes} onChange={(axes) => actions.changeLook({ axes })} />
      </div>
    </>
  );
}
