/** Planes of samples through the volume, with what is black and white in them. */

import { Show } from "solid-js";
import type { VolumeInfo } from "../../protocol/types";
import { sampleRange, usualWindow } from "../../state/bounds";
import type { SliceChoice } from "../../state/look";
import { formatValue } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider } from "../widgets/slider";
import { between } from "./clip";

export default function Body() {
  const { volume } = useModel();
  return <Show when={volume()}>{(known) => <Slices volume={known()} />}</Show>;
}

function Slices(props: { readonly volume: VolumeInfo }) {
  const { look } = useModel();
  const isAny = () => look().slices.planes.some((index) => index !== null);
  return (
    <>
      <SlicePlace axis={0} name="x" volume={props.volume} />
      <SlicePlace axis={1} name="y" volume={props.volume} />
      <SlicePlace axis={2} name="z" volume={props.volume} />
      <Show when={isAny()} fallback={<p class="note">Shows the samples themselves, across the volume's own axes</p>}>
        <WindowLevel volume={props.volume} />
      </Show>
    </>
  );
}

function SlicePlace(props: { readonly axis: 0 | 1 | 2; readonly name: string; readonly volume: VolumeInfo }) {
  const { actions, look } = useModel();
  const index = () => look().slices.planes[props.axis];
  const last = () => props.volume.geometry.dims[props.axis] - 1;
  const change = (value: number | null, gesture?: string) => {
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
