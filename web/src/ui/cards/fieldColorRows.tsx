/** What the colours of a field stand for: the ends of their range, a logarithmic scale, isolines. */

import { createSignal, Show } from "solid-js";
import type { FieldInfo } from "../../protocol/types";
import { MAX_ISOLINES } from "../../state/look";
import { withRanges } from "../../state/featureRanges";
import { coloredByLook } from "../../state/surfaceList";
import { useDescribed } from "../expressions";
import { formatValue } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Select, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { ExpressionEditor } from "./expressionEditor";
import { featureInfo, label, NO_FEATURE } from "./features";
import { colorExpression, fieldScaleOf, logProblem } from "./fieldColors";

/** A number of isolines to begin with. */
const FIRST_ISOLINES = 8;

function useColored() {
  const { selected, surfaces, viewer } = useModel();
  return () => coloredByLook(withRanges(viewer(), surfaces()), selected()?.number ?? 0);
}

export default function FieldColors() {
  const { actions, look, volume } = useModel();
  const colored = useColored();
  const lines = () => {
    const view = colored()?.view;
    return (view && fieldScaleOf(look(), view, volume())?.lines) ?? [];
  };
  return (
    <>
      <Fields />
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

/** As the value of a choice: the field that is the importance. */
const OF_IMPORTANCE = "";

/** Which field the colours of the selected surface are of. It changes no triangle. */
function Fields() {
  const model = useModel();
  const { actions, view, volume } = model;
  const [editing, setEditing] = createSignal(false);
  const expression = () => colorExpression(view(), volume());
  const setRange = ([low, high]: readonly [number, number]) => {
    if (low < high) actions.changeLook({ colorRange: [low, high] });
  };
  const options = () => {
    const feature = view()?.feature ?? NO_FEATURE;
    const names = volume()?.fields.map(({ name }) => name) ?? [];
    const chosen = view()?.colorField ?? undefined;
    const all = [...new Set([...names, ...(chosen === undefined ? [] : [chosen])])].map((name) => ({ value: name, text: label(name) }));
    return feature === NO_FEATURE ? all : [{ value: OF_IMPORTANCE, text: `Importance: ${label(feature)}` }, ...all];
  };
  const use = (info: FieldInfo) => {
    actions.edit({ colorField: info.name });
    setRange(info.range);
    setEditing(false);
  };
  return (
    <>
      <div class="control row">
        <span class="label">Field</span>
        <Select
          label="Field of the colours"
          hideLabel
          value={view()?.colorField ?? OF_IMPORTANCE}
          options={model.may("edit") ? options() : options().filter(({ value }) => value === (view()?.colorField ?? OF_IMPORTANCE))}
          onChange={(name) => actions.edit({ colorField: name === OF_IMPORTANCE ? null : name })}
        />
        <Show when={model.may("edit") && !editing()}>
          <Button quiet label="Colour by an expression" onClick={() => setEditing(true)}>
            Expression…
          </Button>
        </Show>
      </div>
      <Show when={editing()}>
        <ExpressionEditor label="Expression of the colours" value={expression() ?? ""} onUse={use} onClose={() => setEditing(false)} />
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
    if (surface !== undefined && surface.view.colorField !== null) return actions.colorSpan(surface.number, "values");
    const [span, range] = [surface && actions.colorSpan(surface.number, "feature"), surface?.view.featureRange];
    if (span === undefined || range === undefined) return undefined;
    const at = (share: number) => range[0] + share * (range[1] - range[0]);
    return [at(span[0]), at(span[1])] as const;
  };
  const described = useDescribed(() => colorExpression(colored()?.view, volume()));
  const ofVolume = () => {
    const [of, view] = [volume(), colored()?.view];
    if (of === undefined || view === undefined) return undefined;
    const { colorField } = view;
    return colorField === null ? featureInfo(of, view)?.range : (of.fields.find(({ name }) => name === colorField) ?? described()?.info)?.range;
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
  const { look, volume } = useModel();
  const colored = useColored();
  const text = () => {
    const view = colored()?.view;
    const problem = view && logProblem(look(), view, volume());
    const scale = view && fieldScaleOf(look(), view, volume());
    if (problem === undefined || scale === undefined) return undefined;
    if (problem === "linear") return "The scale is linear: no value of the range is above 0, and only such values have a logarithm";
    return `Only values above 0 have a logarithm: the colours begin at ${formatValue(scale.range[0])}, and 0 and below is grey`;
  };
  return <Show when={text()}>{(words) => <p class="note">{words()}</p>}</Show>;
}
