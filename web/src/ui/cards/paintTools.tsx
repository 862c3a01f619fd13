/** What a click on the surface does: adds a point to the editor, or marks a region that stays fine. */

import { createEffect, createSignal, For, onCleanup, Show } from "solid-js";
import type { View } from "../../protocol/types";
import { MAX_REGIONS } from "../../state/interest";
import { lengthUnit, unitWord } from "../../state/lengths";
import { unitsOf } from "../../state/typedNumber";
import { formatValue } from "../format";
import { useModel, useScale } from "../model";
import { Button } from "../widgets/button";
import { Icon } from "../widgets/icon";
import { Slider, type Scale } from "../widgets/slider";
import { Tools } from "./tools";

type Region = View["interest"][number];

/** Smallest and largest radius, as shares of the volume's longest side. */
const RADII = [0.005, 0.25] as const;

const HINTS = { pick: "Click the surface for a point at its value", paint: "Click to keep detail here" } as const;
const TOOLS = [
  { tool: "pick", text: "Pick a value", title: HINTS.pick },
  { tool: "paint", text: "Mark a region", title: HINTS.paint },
] as const;

/** Sphere or box with its position and size. */
export function regionText({ sphere, box }: Region, unit?: string): string {
  const place = (numbers: readonly number[]) => numbers.map((n) => formatValue(n, 3)).join(", ");
  if (sphere !== undefined) return `Radius ${formatValue(sphere.radius, 3)}${unit === undefined ? "" : ` ${unit}`} at ${place(sphere.center)}`;
  return box === undefined ? "" : `Box from ${place(box.min)} to ${place(box.max)}`;
}

/** Equal steps are equal factors. */
function radiusScale(extent: number): Scale {
  const [low, high] = [RADII[0] * extent, RADII[1] * extent];
  return {
    toValue: (t) => Number((low * (high / low) ** t).toPrecision(2)),
    toPosition: (radius) => Math.log(Math.max(radius, 1e-9) / low) / Math.log(high / low),
  };
}

export function PaintTools(props: { readonly view: View }) {
  const { page, viewer } = useModel();
  return (
    <>
      <Tools
        label="What a click on the surface does"
        tools={TOOLS}
        isOffered={(tool) => tool === "paint" || viewer().questions.includes("probe")}
        hint={(tool) => <span>{HINTS[tool]}</span>}
      />
      <Show when={page().tool === "paint"}>
        <Radius />
      </Show>
      <Regions regions={props.view.interest} />
    </>
  );
}

function Radius() {
  const { actions, brush, extent, volume } = useModel();
  return (
    <Slider
      label="Radius"
      value={brush()}
      scale={radiusScale(extent())}
      min={RADII[0] * extent()}
      max={RADII[1] * extent()}
      step={Number((brush() / 10).toPrecision(1))}
      note={unitWord(lengthUnit(volume()))}
      units={unitsOf(lengthUnit(volume()))}
      onChange={(radius) => actions.changePage({ brush: radius })}
      onEnd={() => undefined}
    />
  );
}

/** How many regions of interest there are. */
export function interestText(count: number): string {
  return count === 1 ? "1 region of interest" : `${count} regions of interest`;
}

/** What the list has is outlined in the picture while it is there, and what is pointed at in it more than the rest. */
function Regions(props: { readonly regions: View["interest"] }) {
  const { actions } = useModel();
  const scale = useScale();
  const [pointedAt, setPointedAt] = createSignal<number>();
  createEffect(() => actions.changePage({ outlined: pointedAt() ?? "all" }));
  onCleanup(() => actions.changePage({ outlined: undefined }));
  const remove = (index: number) => {
    // What is no longer there cannot be left.
    setPointedAt(undefined);
    actions.edit({ interest: props.regions.toSpliced(index, 1) });
  };
  return (
    <Show when={props.regions.length > 0}>
      <div class="control row">
        <span class="label">
          {interestText(props.regions.length)}
          {props.regions.length >= MAX_REGIONS ? ", as many as there can be" : ""}
        </span>
        <Button onClick={() => actions.edit({ interest: [] })} quiet>
          Remove all
        </Button>
      </div>
      <ul class="regions">
        <For each={props.regions}>
          {(region, index) => (
            <li
              on:pointerenter={() => setPointedAt(index())}
              on:pointerleave={() => setPointedAt(undefined)}
              on:focusin={() => setPointedAt(index())}
              on:focusout={() => setPointedAt(undefined)}
            >
              <span>{regionText(region, scale().unit)}</span>
              <button type="button" class="icon-button" aria-label={`Remove region ${index() + 1}`} on:click={() => remove(index())}>
                <Icon name="close" />
              </button>
            </li>
          )}
        </For>
      </ul>
    </Show>
  );
}
