/** Planes of samples through the volume, beside the picture and in it, with what is black and white in them. */

import { Show } from "solid-js";
import type { VolumeInfo } from "../../protocol/types";
import { sampleRange, usualWindow } from "../../state/bounds";
import type { SliceChoice } from "../../state/look";
import { crosshairOf, moved, planesAt, type Slicing } from "../../state/slicing";
import { sidesOf } from "../../world/axes";
import { formatValue } from "../format";
import { useModel } from "../model";
import { LAYOUT_OPTIONS, SIDES } from "../slicePanel/words";
import { Button } from "../widgets/button";
import { Choice, Select, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider } from "../widgets/slider";
import { between } from "./clip";
import { label } from "./features";

export default function Body() {
  const { volume } = useModel();
  return <Show when={volume()}>{(known) => <Slices volume={known()} />}</Show>;
}

function Slices(props: { readonly volume: VolumeInfo }) {
  const { look, page } = useModel();
  const isAny = () => page().slicing.layout !== "picture" || look().slices.planes.some((index) => index !== null);
  return (
    <>
      <Beside volume={props.volume} />
      <p class="note">In the picture, across the volume's own axes</p>
      <SlicePlace axis={0} name="x" volume={props.volume} />
      <SlicePlace axis={1} name="y" volume={props.volume} />
      <SlicePlace axis={2} name="z" volume={props.volume} />
      <Show when={isAny()}>
        <WindowLevel volume={props.volume} />
      </Show>
    </>
  );
}

/** Slices beside the picture: the layout, the field, and on which side a patient's left is. */
function Beside(props: { readonly volume: VolumeInfo }) {
  const { actions, page, view } = useModel();
  const slicing = () => page().slicing;
  const change = (of: Partial<Slicing>) => actions.changePage({ slicing: { ...slicing(), ...of } });
  const fields = () => [{ value: "", text: `As the surface: ${label(view()?.field ?? "")}` }, ...props.volume.fields.map(({ name }) => ({ value: name, text: label(name) }))];
  return (
    <>
      <Choice label="Layout" wide value={slicing().layout} options={LAYOUT_OPTIONS} onChange={(layout) => change({ layout })} />
      <Show when={slicing().layout !== "picture"}>
        <Show when={props.volume.fields.length > 1}>
          <Select label="Show" value={slicing().field ?? ""} options={fields()} onChange={(field) => change({ field: field === "" ? undefined : field })} />
        </Show>
        <Show when={sidesOf(props.volume.geometry.frame)["+x"]}>
          <Choice label="Sides" wide value={slicing().leftIsLeft ? "left" : "right"} options={SIDES} onChange={(side) => change({ leftIsLeft: side === "left" })} />
        </Show>
      </Show>
    </>
  );
}

/** While there are slices beside the picture, those in it are where their crosshair is. */
function SlicePlace(props: { readonly axis: 0 | 1 | 2; readonly name: string; readonly volume: VolumeInfo }) {
  const { actions, look, page } = useModel();
  const index = () => planesAt(look().slices.planes, page().slicing, props.volume.geometry.dims)[props.axis];
  const last = () => props.volume.geometry.dims[props.axis] - 1;
  const change = (value: number | null, gesture?: string) => {
    const { slicing } = page();
    const { dims } = props.volume.geometry;
    if (value !== null && index() !== null && slicing.layout !== "picture") {
      return actions.changePage({ slicing: moved(slicing, dims, props.axis, value - crosshairOf(slicing, dims)[props.axis]) });
    }
    const planes = look().slices.planes.map((old, i) => (i === props.axis ? value : old)) as unknown as SliceChoice["planes"];
    actions.changeLook({ slices: { ...look().slices, planes } }, gesture);
  };
  const plane = (value: number) => Math.min(last(), Math.max(0, Math.round(value)));
  return (
    <>
      <Toggle label={`Perpendicular to ${props.name}`} on={index() !== null} onChange={(on) => change(on ? Math.round(last() / 2) : null)} />
      <Show when={index() !== null}>
        <Slider
          label={`Slice across ${props.name}`}
          ends={["0", String(last())]}
          value={index() ?? 0}
          scale={between(0, last())}
          steps={last()}
          words={`${index() ?? 0} of ${last()}`}
          min={0}
          max={last()}
          step={1}
          onChange={(value, gesture) => change(plane(value), gesture)}
          onEnd={actions.endGesture}
        />
      </Show>
    </>
  );
}

/** Width and middle of what lies between black and white, as radiologists say it. */
function WindowLevel(props: { readonly volume: VolumeInfo }) {
  const { actions, look, view } = useModel();
  const range = () => sampleRange(props.volume, view()?.field);
  const size = () => range()[1] - range()[0] || 1;
  const shown = () => look().slices.window ?? usualWindow(props.volume, view()?.field);
  const width = () => shown()[1] - shown()[0];
  const level = () => (shown()[0] + shown()[1]) / 2;
  const change = (of: { readonly width?: number; readonly level?: number }, gesture?: string) => {
    const [w, l] = [Math.max(of.width ?? width(), 1e-6 * size()), of.level ?? level()];
    actions.changeLook({ slices: { ...look().slices, window: [l - w / 2, l + w / 2] } }, gesture);
  };
  const field = (label: string, value: number, set: (value: number) => void) => (
    <NumberField label={label} value={Number(value.toPrecision(6))} step={size() / 100} onChange={set} />
  );
  return (
    <>
      <Slider
        label="Window"
        note="from black to white"
        value={width()}
        scale={between(0, size())}
        words={formatValue(width())}
        field={field("Window", width(), (value) => change({ width: value }))}
        onChange={(value, gesture) => change({ width: value }, gesture)}
        onEnd={actions.endGesture}
      />
      <Slider
        label="Level"
        note="the grey in the middle"
        value={level()}
        scale={between(...range())}
        words={formatValue(level())}
        field={field("Level", level(), (value) => change({ level: value }))}
        onChange={(value, gesture) => change({ level: value }, gesture)}
        onEnd={actions.endGesture}
      />
      <Show when={shown()[0] !== range()[0] || shown()[1] !== range()[1]}>
        <Button quiet onClick={() => actions.changeLook({ slices: { ...look().slices, window: range() } })}>
          Whole range
        </Button>
      </Show>
    </>
  );
}
