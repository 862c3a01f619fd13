/** Parts of the surface that are cut away: by a plane, and by a box. Handles in the picture do the same. */

import { createMemo, Show } from "solid-js";
import type { Vec3, VolumeInfo } from "../../protocol/types";
import { boundsOf, reach, type Bounds } from "../../state/bounds";
import { lengthUnit, unitWord } from "../../state/lengths";
import { unitsOf } from "../../state/typedNumber";
import { NO_CLIP, type ClipChoice } from "../../state/look";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Choice, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider, type Scale } from "../widgets/slider";

type Plane = NonNullable<ClipChoice["plane"]>;
type Box = NonNullable<ClipChoice["box"]>;

const AXES = ["x", "y", "z"] as const;
type Axis = (typeof AXES)[number];
const NORMALS: Readonly<Record<Axis, Vec3>> = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const PLANES = [
  { value: "none", text: "None", hint: "No plane" },
  ...AXES.map((axis) => ({ value: axis, text: `⟂ ${axis}`, hint: `Perpendicular to the world's ${axis} axis` })),
];

/** The world's axis that a normal lies along; `undefined` for a slanted one. */
function axisOf({ normal }: Plane): Axis | undefined {
  return AXES.find((_, axis) => Math.abs(normal[axis] ?? 0) > 1 - 1e-6);
}

/** Linear between two numbers. */
export function between(low: number, high: number): Scale {
  const size = high - low || 1;
  return { toValue: (t) => Number((low + t * size).toPrecision(4)), toPosition: (value) => (value - low) / size };
}

export default function Body() {
  const { volume } = useModel();
  return <Show when={volume()}>{(known) => <Clip volume={known()} />}</Show>;
}

function Clip(props: { readonly volume: VolumeInfo }) {
  const { actions, look } = useModel();
  const bounds = createMemo(() => boundsOf(props.volume.geometry));
  const clip = () => look().clip;
  const change = (of: Partial<ClipChoice>, gesture?: string) => actions.changeLook({ clip: { ...clip(), ...of } }, gesture);
  const choose = (axis: string) => {
    // The half that is nearer to the camera is cut away: the cut is in sight.
    const normal = axis in NORMALS ? actions.facing(NORMALS[axis as Axis]) : undefined;
    // The middle shows at once what a plane does.
    change({ plane: normal && { normal, offset: middle(bounds(), normal) } });
  };
  return (
    <>
      <div class="control">
        <span class="label">Plane</span>
        <Choice<string> label="Plane" wide value={clip().plane === undefined ? "none" : axisOf(clip().plane as Plane)} options={PLANES} onChange={choose} />
      </div>
      <Show when={clip().plane}>{(plane) => <PlanePlace plane={plane()} bounds={bounds()} onChange={(value, gesture) => change({ plane: value }, gesture)} />}</Show>
      <Toggle label="Box" on={clip().box !== undefined} onChange={(on) => change({ box: on ? bounds() : undefined })} />
      <Show when={clip().box}>{(box) => <BoxFaces box={box()} bounds={bounds()} onChange={(value) => change({ box: value })} />}</Show>
      <Toggle label="Fill cut" on={clip().caps} onChange={(caps) => change({ caps })} />
      <Show when={clip().plane ?? clip().box} fallback={<p class="note">No clipping</p>}>
        <div class="control row">
          <p class="note">Drag the handles in the picture</p>
          <Button quiet onClick={() => actions.changeLook({ clip: { ...NO_CLIP, caps: clip().caps } })}>
            Show all
          </Button>
        </div>
      </Show>
    </>
  );
}

function middle(bounds: Bounds, normal: Vec3): number {
  const [low, high] = reach(bounds, normal);
  return Number(((low + high) / 2).toPrecision(4));
}

const turned = (normal: Vec3) => normal.map((n) => -n || 0) as unknown as Vec3;

function PlanePlace(props: { readonly plane: Plane; readonly bounds: Bounds; readonly onChange: (plane: Plane, gesture?: string) => void }) {
  const { actions, volume } = useModel();
  /** Across an axis the place is the coordinate, whichever side is cut away. */
  const sign = () => (axisOf(props.plane) !== undefined && props.plane.normal.some((n) => n < -0.5) ? -1 : 1);
  const place = () => sign() * props.plane.offset;
  const range = () => reach(props.bounds, sign() < 0 ? turned(props.plane.normal) : props.plane.normal);
  const move = (to: number, gesture?: string) => props.onChange({ ...props.plane, offset: sign() * to }, gesture);
  const flip = () => props.onChange({ normal: turned(props.plane.normal), offset: -props.plane.offset || 0 });
  return (
    <Slider
      label="Where the plane lies"
      ends={["", ""]}
      value={place()}
      scale={between(...range())}
      words={`${place()} ${unitWord(lengthUnit(volume()))}`}
      field={
        <>
          <NumberField label="Where the plane lies" value={place()} units={unitsOf(lengthUnit(volume()))} step={(range()[1] - range()[0]) / 100} onChange={(to) => move(to)} />
          <Button quiet onClick={flip}>
            Flip
          </Button>
        </>
      }
      onChange={move}
      onEnd={actions.endGesture}
    />
  );
}

function BoxFaces(props: { readonly box: Box; readonly bounds: Bounds; readonly onChange: (box: Box) => void }) {
  const { volume } = useModel();
  const units = () => unitsOf(lengthUnit(volume()));
  const faces = (axis: 0 | 1 | 2, name: Axis) => {
    const moved = (side: "min" | "max", value: number): Box => ({ ...props.box, [side]: props.box[side].map((n, i) => (i === axis ? value : n)) });
    const step = () => (props.bounds.max[axis] - props.bounds.min[axis]) / 100 || 1;
    return (
      <div class="control row">
        <span class="label">{name}</span>
        <span class="pair">
          from
          <NumberField label={`${name} from`} value={props.box.min[axis]} max={props.box.max[axis]} step={step()} units={units()} onChange={(value) => props.onChange(moved("min", value))} />
          to
          <NumberField label={`${name} to`} value={props.box.max[axis]} min={props.box.min[axis]} step={step()} units={units()} onChange={(value) => props.onChange(moved("max", value))} />
        </span>
      </div>
    );
  };
  return (
    <>
      {faces(0, "x")}
      {faces(1, "y")}
      {faces(2, "z")}
    </>
  );
}
