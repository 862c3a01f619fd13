/** Controls of importance, which keeps the surface fine: a feature, its weight against the shape, the transfer function, and regions of interest. */

import { createMemo, createSignal, Show } from "solid-js";
import { GRADIENT, NO_FEATURE, bestOther, featureInfo, label, otherFeatures } from "./features";
import type { DerivedInfo, Distribution, FieldInfo, View, VolumeInfo } from "../../protocol/types";
import { isExpression } from "../../state/expressions";
import { ownRange } from "../../state/fields";
import { unitsOf } from "../../state/typedNumber";
import { useDescribed } from "../expressions";
import { formatShare } from "../format";
import { useModel } from "../model";
import type { Background } from "../plots/transferPlot";
import { Button } from "../widgets/button";
import { Choice, Select, Toggle } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { LINEAR, Slider } from "../widgets/slider";
import { evaluate } from "../../transfer/model";
import type { Card } from "./card";
import { ExpressionEditor } from "./expressionEditor";
import { PaintTools } from "./paintTools";
import { TransferEditor } from "./transferEditor";

/** What α means, in words. */
export function alphaText(alpha: number, feature: string): string {
  const name = feature === GRADIENT ? "edges" : label(feature);
  if (alpha <= 0) return "shape alone";
  if (alpha >= 1) return `${name} alone`;
  return `${Math.round(100 * (1 - alpha))} % shape, ${Math.round(100 * alpha)} % ${name}`;
}

type Kind = "shape" | "edges" | "field";

function kindOf({ feature }: View): Kind {
  if (feature === NO_FEATURE) return "shape";
  return feature === GRADIENT ? "edges" : "field";
}

function Body() {
  const { view, volume } = useModel();
  const open = createMemo(() => {
    const [known, inForce] = [volume(), view()];
    return known !== undefined && inForce !== undefined ? { volume: known, view: inForce } : undefined;
  });
  return <Show when={open()}>{(now) => <Matters volume={now().volume} view={now().view} />}</Show>;
}

function Matters(props: { readonly volume: VolumeInfo; readonly view: View }) {
  const { actions, comparing, picked, probe, viewer } = useModel();
  const expression = () => (isExpression(props.volume, props.view.feature) ? props.view.feature : undefined);
  const described = useDescribed(expression);
  const info = createMemo(() => (expression() === undefined ? featureInfo(props.volume, props.view) : described()?.info));
  /** β, if it decides: the view's, or for marching cubes the one that was found for a budget. */
  const beta = () => props.view.beta ?? (props.view.mesher === "marching-cubes" ? (viewer().statistics?.beta ?? undefined) : undefined);
  const distribution = () => viewer().answers.distribution?.value;
  const [wantsRaw, setRaw] = createSignal(false);
  const raw = createMemo((): Background | undefined => {
    const [histogram, range] = [info()?.histogram, props.view.featureRange];
    return histogram === undefined || range === undefined ? undefined : { histogram, range };
  });
  const ofSurface = createMemo(() => onSurface(distribution()));
  const mark = () => {
    const found = probe();
    const x = found?.surface === viewer().selected ? found.nearest?.blended : undefined;
    return x === undefined ? undefined : { x, importance: evaluate(props.view.transferFunction.points, x).importance };
  };
  const isRaw = () => raw() !== undefined && (wantsRaw() || ofSurface() === undefined);
  return (
    <>
      <Features {...props} />
      <Show when={kindOf(props.view) === "field"}>
        <Computed expression={expression()} />
      </Show>
      <Show when={props.view.feature !== NO_FEATURE}>
        <Weight view={props.view} />
      </Show>
      <TransferEditor
        points={props.view.transferFunction.points}
        background={isRaw() ? raw() : ofSurface()}
        threshold={beta()}
        mark={mark()}
        picked={picked()}
        legend={
          <div class="plot-legend">
            <span class="note">{isRaw() ? `All values of ${label(props.view.feature)}` : coarseText(distribution()?.coarseShare)}</span>
            <Show when={raw() !== undefined && ofSurface() !== undefined}>
              <Button quiet onClick={() => setRaw(!wantsRaw())}>
                {isRaw() ? "This surface" : "Raw values"}
              </Button>
            </Show>
          </div>
        }
        onChange={actions.editPoints}
        onEnd={actions.endGesture}
      />
      <PaintTools view={props.view} />
      <Toggle
        label="Same budget without importance"
        on={comparing() === "importance"}
        onChange={(on) => actions.compare(on ? "importance" : undefined)}
      />
      <Show when={props.view.feature !== NO_FEATURE}>
        <Range view={props.view} info={info()} />
      </Show>
    </>
  );
}

/** What the editor's axis is, of this surface. */
export function onSurface(distribution: Distribution | undefined): Background | undefined {
  if (distribution === undefined) return undefined;
  const histogram = (counts: readonly number[]) => ({ min: 0, max: 1, counts });
  return { histogram: histogram(distribution.bins), range: [0, 1], coarse: histogram(distribution.coarse) };
}

/** How much of the surface is merged into larger parts. */
export function coarseText(share: number | undefined): string {
  if (share === undefined) return "";
  if (share <= 0) return "Nothing of this surface is simplified";
  return `${formatShare(share)} of the surface is simplified (hatched)`;
}

function Features(props: { readonly volume: VolumeInfo; readonly view: View }) {
  const { actions } = useModel();
  const choose = (feature: string) => actions.edit({ feature, featureRange: ownRange(featureInfo(props.volume, { feature, field: props.view.field })) });
  const others = () => otherFeatures(props.volume, props.view.field);
  const kinds = () => [
    { value: "shape" as const, text: "Shape", hint: "Fine where the surface bends" },
    { value: "edges" as const, text: "Edges", hint: "Fine where values change fast: the gradient's magnitude" },
    ...(others().length === 0 ? [] : [{ value: "field" as const, text: "Field", hint: "Fine where a field, or a feature computed from the data, is high" }]),
  ];
  const chooseKind = (kind: Kind) => choose(kind === "shape" ? NO_FEATURE : kind === "edges" ? GRADIENT : (bestOther(props.volume, props.view.field) ?? NO_FEATURE));
  return (
    <div class="control row">
      <Choice<Kind> label="Importance by" value={kindOf(props.view)} options={kinds()} onChange={chooseKind} />
      <Show when={kindOf(props.view) === "field"}>
        <Select label="Importance field" hideLabel value={props.view.feature} options={[...new Set([...others(), props.view.feature])].map((name) => ({ value: name, text: label(name) }))} onChange={choose} />
      </Show>
      <Show when={kindOf(props.view) === "edges"}>
        <span class="note" title={`α: ${alphaText(props.view.alpha, props.view.feature)}`}>
          α: {Math.round(100 * props.view.alpha)} % edges
        </span>
      </Show>
    </div>
  );
}

/** The field that matters as an expression over others. */
function Computed(props: { readonly expression: string | undefined }) {
  const { actions } = useModel();
  const [editing, setEditing] = createSignal(false);
  const use = (info: FieldInfo) => actions.edit({ feature: info.name, featureRange: ownRange(info) });
  return (
    <Show
      when={editing()}
      fallback={
        <Button quiet class="compute" onClick={() => setEditing(true)}>
          {props.expression === undefined ? "Expression…" : "Change the expression…"}
        </Button>
      }
    >
      <ExpressionEditor label="Expression of the importance field" value={props.expression ?? ""} onUse={use} onClose={() => setEditing(false)} />
    </Show>
  );
}

function Weight(props: { readonly view: View }) {
  const { actions } = useModel();
  const words = () => alphaText(props.view.alpha, props.view.feature);
  return (
    <Slider
      label="Balance α"
      ends={["Shape", props.view.feature === GRADIENT ? "Edges" : "Field"]}
      value={props.view.alpha}
      scale={LINEAR}
      min={0}
      max={1}
      step={0.01}
      hundredPercent={1}
      words={words()}
      onChange={(alpha, gesture) => actions.edit({ alpha }, gesture)}
      onEnd={actions.endGesture}
    />
  );
}

/** Which feature values are the ends of the editor's axis. */
function Range(props: { readonly view: View; readonly info: DerivedInfo | undefined }) {
  const { actions } = useModel();
  const range = () => props.view.featureRange;
  const step = () => Number((((range()?.[1] ?? 1) - (range()?.[0] ?? 0)) / 50).toPrecision(1));
  const change = (low: number, high: number) => {
    if (low < high) actions.edit({ featureRange: [low, high] });
  };
  return (
    <Show when={range()} fallback={<p class="note">From 0 (left) to 1 (right) over the feature's own range</p>}>
      {(ends) => (
        <div class="control row">
          <span class="label">Axis from</span>
          <span class="pair">
            <NumberField label="Feature value that becomes 0" value={ends()[0]} step={step()} units={unitsOf(props.info?.unit)} max={ends()[1] - step()} onChange={(low) => change(low, ends()[1])} />
            <span>to</span>
            <NumberField label="Feature value that becomes 1" value={ends()[1]} step={step()} units={unitsOf(props.info?.unit)} min={ends()[0] + step()} onChange={(high) => change(ends()[0], high)} />
            <span class="unit">{props.info?.unit ?? ""}</span>
          </span>
        </div>
      )}
    </Show>
  );
}

export const mattersCard: Card = { id: "matters", title: "Importance", icon: "matters", isOfSurface: true, needs: "edit", body: Body };
