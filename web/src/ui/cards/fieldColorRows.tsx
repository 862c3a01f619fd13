/** What the colours of a field stand for: the ends of their range, a logarithmic scale, isolines. */

import { Show } from "solid-js";
import { MAX_ISOLINES } from "../../state/look";
import { withRanges } from "../../state/featureRanges";
import { coloredByLook } from "../../state/surfaceList";
import { formatValue } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { featureInfo } from "./features";
import { fieldScaleOf, logProblem } from "./fieldColors";

/** A number of isolines to begin with. */
const FIRST_ISOLINES = 8;

function useColored() {
  const { selected, surfaces, viewer } = useModel();
  return () => coloredByLook(withRanges(viewer(), surfaces()), selected()?.number ?? 0);
}

export default function FieldColors() {
  const { actions, look } = useModel();
  const colored = useColored();
  const lines = () => {
    const view = colored()?.view;
    return (view && fieldScaleOf(look(), view)?.lines) ?? [];
  };
  return (
    <>
      <Ranges />
      <div class="switches">
        <Toggle label="Log scale" on={look().logColors} onChange={(logColors) => actions.changeLook({ logColors })} />
        <Toggle label="Isolines" on={look().isolines > 0} onChange={(on) => actions.changeLook({ isolines: on ? FIRST_ISOLINES : 0 })} />
      </div>
      <LogNote />
      <Show when={look().isolines > 0}>
        <div class="control row">
          <span class="label">Isolines, at most</span>
          <NumberField label="Isolines, at most" isWhole value={look().isolines} min={1} max={MAX_ISOLINES} onChange={(count) => actions.changeLook({ isolines: Math.round(count) })} />
        </div>
        <p class="note">{lines().length === 0 ? "No round value is inside the range" : `At ${lines().map((value) => formatValue(Number(value.toPrecision(9)))).join(", ")}`}</p>
      </Show>
    </>
  );
}

/** The values that the field has on the surface, or in the volume, as the range. */
function Ranges() {
  const { actions, volume } = useModel();
  const colored = useColored();
  const set = (range: readonly [number, number] | undefined) => {
    if (range !== undefined && range[0] < range[1]) actions.changeLook({ colorRange: [Number(formatValue(range[0], 6)), Number(formatValue(range[1], 6))] });
  };
  const ofSurface = () => {
    const surface = colored();
    const [span, range] = [surface && actions.featureSpan(surface.number), surface?.view.featureRange];
    if (span === undefined || range === undefined) return undefined;
    const at = (share: number) => range[0] + share * (range[1] - range[0]);
    return [at(span[0]), at(span[1])] as const;
  };
  const ofVolume = () => {
    const [of, view] = [volume(), colored()?.view];
    return of && view && featureInfo(of, view)?.range;
  };
  return (
    <div class="control row">
      <span class="label">Range of</span>
      <Button label="Range of the surface" onClick={() => set(ofSurface())}>Surface</Button>
      <Button label="Range of the volume" disabled={ofVolume() === undefined} onClick={() => set(ofVolume())}>Volume</Button>
    </div>
  );
}

/** Why a logarithmic scale is not as it was asked for. */
function LogNote() {
  const { look } = useModel();
  const colored = useColored();
  const text = () => {
    const view = colored()?.view;
    const problem = view && logProblem(look(), view);
    const scale = view && fieldScaleOf(look(), view);
    if (problem === undefined || scale === undefined) return undefined;
    if (problem === "linear") return "The scale is linear: no value of the range is above 0, and only such values have a logarithm";
    return `Only values above 0 have a logarithm: the colours begin at ${formatValue(scale.range[0])}, and 0 and below is grey`;
  };
  return <Show when={text()}>{(words) => <p class="note">{words()}</p>}</Show>;
}
