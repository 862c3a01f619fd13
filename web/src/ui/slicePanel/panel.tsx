/** Three slices across the axes of the volume, through one crosshair, and what is there. Loaded when they are shown. */

import { isEqual } from "../../protocol/equal";
import { createEffect, createMemo, createSignal, For, onCleanup, Show } from "solid-js";
import { sampleAt } from "../../slices/paint";
import { sliceViews, type SliceView } from "../../slices/view";
import type { VolumeInfo } from "../../protocol/types";
import { lengthUnit } from "../../state/lengths";
import { crosshairOf, type SliceState } from "../../state/slicing";
import type { Triple } from "../../world/places";
import { label } from "../cards/features";
import { formatValue } from "../format";
import { useModel } from "../model";
import { placeOf } from "../surfaceNames";
import { Button } from "../widgets/button";
import { SlicePane } from "./pane";
import { useShownField, useWindow } from "./shown";
import { positionWords, problemWords, valueWords } from "./words";
import "../style/slices.css";

export default function SlicePanel() {
  const { page, volume } = useModel();
  let section: HTMLElement | undefined;
  createEffect(() => {
    // The picture, which had the focus, is hidden now.
    const isPicture = document.activeElement?.matches(".viewport *") === true;
    if (page().slicing.layout === "slices" && isPicture) section?.querySelector<HTMLElement>(".slice-picture")?.focus();
  });
  return (
    <Show when={volume()}>
      {(known) => (
        <section ref={(element) => (section = element)} class="slice-panel" aria-label="Slices" data-layout={page().slicing.layout}>
          <Panes volume={known()} />
        </section>
      )}
    </Show>
  );
}

function Panes(props: { readonly volume: VolumeInfo }) {
  const { page } = useModel();
  // Others make other panes, which a drag would not survive.
  const leftIsLeft = createMemo(() => page().slicing.leftIsLeft);
  const geometry = createMemo(() => props.volume.geometry, undefined, { equals: isEqual });
  const views = createMemo(() => sliceViews(geometry(), leftIsLeft()));
  /** On a narrow page there is one at a time. */
  const [chosen, setChosen] = createSignal(0);
  const [hovered, setHovered] = createSignal<Triple>();
  return (
    <>
      <div class="slice-tabs" role="group" aria-label="Which slice">
        <For each={views()}>
          {({ name }, place) => (
            <button type="button" class="chip" aria-pressed={chosen() === place()} on:click={() => setChosen(place())}>
              {name}
            </button>
          )}
        </For>
      </div>
      <For each={views()}>{(view, place) => <SlicePane view={view} volume={props.volume} isChosen={chosen() === place()} onHover={setHovered} />}</For>
      <Facts volume={props.volume} views={views()} hovered={hovered()} />
    </>
  );
}

/** What is at the crosshair, or under the pointer. */
function Facts(props: { readonly volume: VolumeInfo; readonly views: readonly SliceView[]; readonly hovered: Triple | undefined }) {
  const { page, slices, surfaces } = useModel();
  const field = useShownField();
  const shownWindow = useWindow();
  const at = () => crosshairOf(page().slicing, props.volume.geometry.dims);
  const valueAt = (index: Triple) => valueOf(index, props.views, slices(), field(), props.volume);
  const position = (index: Triple) => positionWords(props.volume.geometry, index, lengthUnit(props.volume));
  const index = () => props.hovered ?? at();
  return (
    <div class="slice-facts">
      <dl class="rows" aria-label={props.hovered === undefined ? "At the crosshair" : "Under the pointer"}>
        <dt>{label(field())}</dt>
        <dd class="slice-value">{valueAt(index())}</dd>
        <dt>x, y, z</dt>
        <dd>{position(index())}</dd>
        <dt>Sample</dt>
        <dd>{index().join(", ")}</dd>
        <dt class="more">Black to white</dt>
        <dd class="more">{shownWindow().map((value) => formatValue(value)).join(" to ")}</dd>
        <For each={surfaces()}>
          {({ number, view, style }) => (
            <>
              <dt class="more">{surfaces().length > 1 ? `Outline ${placeOf(surfaces(), number)}` : "Outline"}</dt>
              <dd class="more">{style.visible ? `${label(view.field)} ${formatValue(view.iso)}` : "hidden"}</dd>
            </>
          )}
        </For>
      </dl>
      <p class="note more">Click or drag to move the crosshair, turn the wheel for other slices, drag with the right button for window and level; a double click resets these</p>
      <Said text={`${label(field())} ${valueAt(at())}, ${position(at())}`} />
      <Problem />
    </div>
  );
}

function valueOf(index: Triple, views: readonly SliceView[], slices: readonly SliceState[], field: string, volume: VolumeInfo): string {
  for (const view of views) {
    const loaded = slices[view.across]?.loaded;
    const plane = loaded?.planes.get(field);
    if (plane === undefined || loaded?.index !== index[view.across]) continue;
    return valueWords(sampleAt(view, plane, index[view.axes[0]], index[view.axes[1]]), volume.fields.find(({ name }) => name === field));
  }
  return "…";
}

/** After the crosshair has come to rest, for readers of the screen. */
const QUIET_MS = 700;

function Said(props: { readonly text: string }) {
  const [text, setText] = createSignal("");
  createEffect(() => {
    const now = props.text;
    const timer = setTimeout(() => setText(now), QUIET_MS);
    onCleanup(() => clearTimeout(timer));
  });
  return (
    <p class="unseen" role="status">
      {text()}
    </p>
  );
}

function Problem() {
  const { actions, slices: all, viewer } = useModel();
  const text = () => {
    const slices = all();
    return problemWords(slices.map(({ problem }) => problem), slices.every(({ isCurrent }) => isCurrent), viewer().connection, slices.some(({ loaded }) => loaded !== undefined));
  };
  return (
    <Show when={text()}>
      <div class="slice-problem" role="alert">
        <span>{text()}</span>
        <Show when={viewer().connection === "connected"}>
          <Button quiet onClick={() => actions.retrySlices()}>
            Try again
          </Button>
        </Show>
      </div>
    </Show>
  );
}
