/** What is taken along: images, a turntable, the mesh, the link, the command line. */

import { createSignal, For, Show } from "solid-js";
import { formatPercent } from "../format";
import { FORMATS } from "../exportMenu";
import type { ImageRequest } from "../actions";
import { useModel } from "../model";
import { useSurfaceName, useVisibleCount } from "../surfaceNames";
import { Needs } from "../needs";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { TextRow } from "../widgets/textRow";

const SCALES = [1, 2, 3, 4].map((scale) => ({ value: scale, text: `${scale} ×`, hint: `${scale} pixels for one of the page` }));
/** As `MAX_FRAMES` of the turntable. */
const MOST_FRAMES = 720;
const FRAMES = 60;

/** Kept while the page is open: the card may be folded in between. */
const [request, setRequest] = createSignal<ImageRequest>({ scale: 2, transparent: false, colorBar: true, scaleBar: true, isovalues: true, slices: true, caption: "" });
const [frames, setFrames] = createSignal(FRAMES);
const [wantsCap, setCap] = createSignal(false);

export default function Body() {
  const { actions, look, page, view } = useModel();
  /** The paper's mesher knows no caps. */
  const canCap = () => view()?.mesher === "dual";
  const cap = () => canCap() && wantsCap();
  const name = useSurfaceName();
  const visible = useVisibleCount();
  const change = (of: Partial<ImageRequest>) => setRequest({ ...request(), ...of });
  return (
    <>
      <div class="control row">
        <span class="label">Size</span>
        <Choice<number> label="Size of the image" value={request().scale} options={SCALES} onChange={(scale) => change({ scale })} />
      </div>
      <div class="switches">
        <Toggle label="Transparent" on={request().transparent} onChange={(transparent) => change({ transparent })} />
        <Toggle label="Scale bar" on={request().scaleBar} onChange={(scaleBar) => change({ scaleBar })} />
        <Show when={visible() > 1}>
          <Toggle label="Isovalues" on={request().isovalues} onChange={(isovalues) => change({ isovalues })} />
        </Show>
        <Show when={page().slicing.layout !== "picture"}>
          <Toggle label="Slices" on={request().slices} onChange={(slices) => change({ slices })} />
        </Show>
        <Show when={look().colorBy !== "material"}>
          <Toggle label="Colour bar" on={request().colorBar} onChange={(colorBar) => change({ colorBar })} />
        </Show>
      </div>
      <TextRow label="Caption" value={request().caption} maxLength={300} placeholder="none" onInput={(caption) => change({ caption })} />
      <div class="control row">
        <span class="label">Image</span>
        <Button onClick={() => actions.saveImage(request())}>Save PNG</Button>
      </div>
      <Turn />
      <Needs role="export">
        <div class="control row">
          <span class="label">Mesh{name() && ` of ${name()}`}</span>
          <span class="inline">
            <For each={FORMATS}>
              {({ format, text }) => (
                <button type="button" class="chip" title={text} on:click={() => actions.download(format, cap())}>
                  {format.toUpperCase()}
                </button>
              )}
            </For>
          </span>
        </div>
        <All />
        <Show when={canCap()}>
          <Toggle label="Cap at volume boundary" on={wantsCap()} onChange={setCap} />
        </Show>
      </Needs>
      <div class="control row">
        <span class="label">Copy</span>
        <span class="inline">
          <Button onClick={actions.copyLink}>Link</Button>
          <Button onClick={() => actions.copyCommand(cap())}>Command</Button>
        </span>
      </div>
    </>
  );
}

/** The mesh of all surfaces that are seen. */
function All() {
  const { actions } = useModel();
  const visible = useVisibleCount();
  return (
    <Show when={visible() > 1}>
      <div class="control row">
        <span class="label">Mesh of all {visible()} visible</span>
        <button type="button" class="chip" title="GLB, with the page's colours" on:click={() => actions.downloadAll(wantsCap())}>
          GLB
        </button>
      </div>
    </Show>
  );
}

function Turn() {
  const { actions, turning } = useModel();
  return (
    <div class="control row">
      <span class="label">Turntable</span>
      <span class="inline">
        <Show when={turning() === undefined} fallback={<span role="status">{formatPercent(turning() ?? 0)}</span>}>
          <NumberField label="Images of a turn" value={frames()} min={2} max={MOST_FRAMES} isWhole step={10} onChange={(n) => setFrames(Math.round(n))} />
          images
        </Show>
        <Button onClick={() => actions.saveTurn(request(), frames())}>{turning() === undefined ? "Save ZIP" : "Stop"}</Button>
      </span>
    </div>
  );
}
