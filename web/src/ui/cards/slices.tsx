/** Planes of samples through the volume, beside the picture and in it, with what is black and white in them. */

import { Show } from "solid-js";
import type { VolumeInfo } from "../../protocol/types";
import { sampleRange } from "../../state/bounds";
import type { SliceChoice } from "../../state/look";
import { crosshairOf, moved, planesAt, type Slicing } from "../../state/slicing";
import { sidesOf } from "../../world/axes";
import { formatValue } from "../format";
import { useModel } from "../model";
import { useShownField, useWindow } from "../slicePanel/shown";
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
      <p class="note">In the picture, along the volume's own axes</p>
      <SlicePlace axis={0} name="x" volume={props.volume} />
      <SlicePlace axis={1} name="y" volume={props.volume} />
      <SlicePlace axis={2} name="z" volume={props.volume} />
      <Show when={isAny()}>
        <ShownField volume={props.volume} />
        <WindowLevel volume={props.volume} />
      </Show>
    </>
  );
}

/** Slices beside the picture, and on which side a patient's left is in them. */
function Beside(props: { readonly volume: VolumeInfo }) {
  const { actions, page } = useModel();
  const slicing = () => page().slicing;
  const change = (of: Partial<Slicing>) => actions.changePage({ slicing: { ...slicing(), ...of } });
  return (
    <>
      <Choice label="Layout" wide value={slicing().layout} options={LAYOUT_OPTIONS} onChange={(layout) => change({ layout })} />
      <Show when={slicing().layout !== "picture" && sidesOf(props.volume.geometry.frame)["+x"]}>
        <div class="control">
          <span class="label">A patient's left is</span>
          <Choice label="A patient's left is" wide value={slicing().leftIsLeft ? "left" : "right"} options={SIDES} onChange={(side) => change({ leftIsLeft: side === "left" })} />
        </div>
      </Show>
    </>
  );
}

/** The field that is shown. Another one has other values: it begins with the window that is usual for it. */
function ShownField(props: { readonly volume: VolumeInfo }) {
  const { actions, look, page, view } = useModel();
  const fields = () => [{ value: "", text: `As the surface: ${label(view()?.field ?? "")}` }, ...props.volume.fields.map(({ name }) => ({ value: name, text: label(name) }))];
  const choose = (field: string) => {
    actions.changePage({ slicing: { ...page().slicing, field: field === "" ? undefined : field } });
    if (look().slices.window !== undefined) actions.changeLook({ slices: { ...look().slices, window: undefined } });
  };
  return (
    <Show when={props.volume.fields.length > 1}>
      <Select label="Show" value={page().slicing.field ?? ""} options={fields()} onChange={choose} />
    </Show>
  );
}

/** Position of a slice in the picture. While slices are also shown beside the picture, it follows their crosshair. */
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
  const { actions, look } = useModel();
  const field = useShownField();
  const shown = useWindow();
  const range = () => (props.volume.fields.some(({ name }) => name === field()) ? sampleRange(props.volume, field()) : shown());
  const size = () => range()[1] - range()[0] || 1;
  const width = () => shown()[1] - shown()[0];
  const level = () => (shown()[0] + shown()[1]) / 2;
  const change = (of: { readonly width?: number; readonly level?: number }, gesture?: string) => {
    const [w, l] = [Math.max(of.width ?? width(), 1e-6 * size()), of.level ?? level()];
    actions.changeLook({ slices: { ...look().slices, window: [l - w / 2, l + w / 2] } }, gesture);
  };
  const numberField = (label: string, value: number, set: (value: number) => void) => (
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
        field={numberField("Window", width(), (value) => change({ width: value }))}
        onChange={(value, gesture) => change({ width: value }, gesture)}
        onEnd={actions.endGesture}
      />
      <Slider
        label="Level"
        note="the grey in the middle"
        value={level()}
        scale={between(...range())}
        words={formatValue(level())}
        field={numberField("Level", level(), (value) => change({ level: value }))}
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
