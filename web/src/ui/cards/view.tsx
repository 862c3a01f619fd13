/** From where the surface is seen, and what is drawn beside it. */

import { createMemo, For } from "solid-js";
import { sidesOf, type AxisName } from "../../world/axes";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";

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
      <div class="switches">
        <Toggle label="Bounding box" on={look().box} onChange={(box) => actions.changeLook({ box })} />
        <Toggle label="Scale bar" on={look().scale} onChange={(scale) => actions.changeLook({ scale })} />
        <Toggle label="Axes cube" on={look().axes} onChange={(axes) => actions.changeLook({ axes })} />
      </div>
    </>
  );
}
