/** The volume at a low resolution behind and around the surface: to see what there is, and which isovalue encloses it. */

import { createMemo, createSignal, Show } from "solid-js";
import type { FieldInfo } from "../../protocol/types";
import { usualWindow } from "../../state/bounds";
import { windowOf, type VolumeChoice } from "../../state/look";
import { useDescribed } from "../expressions";
import { digitsBetween, formatShare, formatValue } from "../format";
import { useModel } from "../model";
import { HistogramSlider, type IsoHandle } from "../plots/histogramSlider";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { LINEAR, Slider } from "../widgets/slider";

const MODES = [
  { value: "off", text: "Off", hint: "The surface alone" },
  { value: "maximum", text: "Maximum", hint: "Maximum intensity projection: the largest value along each ray" },
  { value: "rendering", text: "Rendering", hint: "Volume rendering: all values along each ray, as a cloud" },
] as const;

/** Numbers of the handles of the window and the isovalue. */
const [LOW, HIGH, ISO] = [0, 1, 2];

export default function Body() {
  const { actions, look, view, volume } = useModel();
  const own = () => volume()?.fields.find(({ name }) => name === view()?.field);
  const described = useDescribed(() => (own() === undefined ? view()?.field : undefined));
  const field = createMemo(() => own() ?? described()?.info);
  const change = (of: Partial<VolumeChoice>, gesture?: string) => actions.changeLook({ volume: { ...look().volume, ...of } }, gesture);
  return (
    <>
      <Choice label="Volume" wide value={look().volume.mode} options={MODES} onChange={(mode) => change({ mode })} />
      <Show when={look().volume.mode !== "off"} fallback={<p class="note">The samples at a low resolution, around the surface</p>}>
        <Slider
          label="Opacity of the volume"
          value={look().volume.opacity}
          scale={LINEAR}
          words={formatShare(look().volume.opacity)}
          min={0}
          max={1}
          step={0.05}
          onChange={(opacity, gesture) => change({ opacity }, gesture)}
          onEnd={actions.endGesture}
        />
        <Show when={field()}>{(known) => <Window field={known()} onChange={change} />}</Show>
        <Toggle label="Mark values from the isovalue on" on={look().volume.marksIso} onChange={(marksIso) => change({ marksIso })} />
      </Show>
    </>
  );
}

/** Which values are seen, on the field's histogram, with the isovalue beside them. */
function Window(props: { readonly field: FieldInfo; readonly onChange: (of: Partial<VolumeChoice>, gesture?: string) => void }) {
  const model = useModel();
  const { actions, look, view, volume } = model;
  const [selected, setSelected] = createSignal(LOW);
  const range = () => [props.field.histogram.min, props.field.histogram.max] as const;
  const usual = () => {
    const known = volume();
    return known?.fields.some(({ name }) => name === props.field.name) === true ? usualWindow(known, props.field.name) : range();
  };
  const chosen = () => windowOf(look().volume, view()?.field ?? props.field.name);
  const window = () => chosen() ?? usual();
  const digits = () => digitsBetween(...range());
  const set = (end: number, value: number, gesture?: string) => {
    const [low, high] = window();
    const least = (range()[1] - range()[0]) / 256 || 1;
    const ends = end === LOW ? ([Math.min(value, high - least), high] as const) : ([low, Math.max(value, low + least)] as const);
    props.onChange({ window: ends, windowField: view()?.field ?? props.field.name }, gesture);
  };
  const handles = (): readonly IsoHandle[] => [
    { number: LOW, label: "Lower end of the window", value: window()[0], mark: "‹", color: undefined },
    { number: HIGH, label: "Upper end of the window", value: window()[1], mark: "›", color: undefined },
    ...(model.may("edit") ? [{ number: ISO, label: "Isovalue", value: view()?.iso ?? 0, mark: "=", color: "#ff9f45" }] : []),
  ];
  return (
    <div class="control">
      <div class="control-head">
        <span class="label">Window</span>
        <span class="spring" />
        <NumberField label="Lower end of the window" value={window()[0]} digits={digits() + 1} step={(range()[1] - range()[0]) / 100 || 1} onChange={(value) => set(LOW, value)} />
        <NumberField label="Upper end of the window" value={window()[1]} digits={digits() + 1} step={(range()[1] - range()[0]) / 100 || 1} onChange={(value) => set(HIGH, value)} />
      </div>
      <HistogramSlider
        histogram={props.field.histogram}
        handles={handles()}
        selected={selected()}
        unit={props.field.unit ?? undefined}
        onSelect={setSelected}
        onChange={(value) => (selected() === ISO ? actions.edit({ iso: value }, "iso") : set(selected(), value, "volume window"))}
        onEnd={actions.endGesture}
      />
      <div class="axis-labels">
        <span>{formatValue(range()[0], digits())}</span>
        <span>{formatValue(range()[1], digits())}</span>
      </div>
      <Show when={chosen() !== undefined}>
        <Button quiet onClick={() => props.onChange({ window: undefined, windowField: undefined })}>
          Usual window
        </Button>
      </Show>
    </div>
  );
}
