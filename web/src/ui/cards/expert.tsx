/** What decides how much is merged, within which guards, and what else is changed rarely. */

import { Show, type JSX } from "solid-js";
import { LEVELS } from "../../protocol/generated";
import type { Edit, Statistics, View } from "../../protocol/types";
import { unitWord } from "../../state/lengths";
import { budgetEdit } from "../../state/sharedBudget";
import { cutsTree } from "../../protocol/view";
import type { ViewerState } from "../../state/viewer";
import { formatValue } from "../format";
import { useModel, useScale, useSpacing } from "../model";
import { Choice, Select } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider } from "../widgets/slider";
import { criterion, type Criterion } from "./criterion";
import { ErrorRows } from "./errorRows";
import { FIRST_ERROR } from "./errorUnits";
import { BETA_SCALE } from "./scales";

/** Initial values if nothing better is known. */
const FIRST = { beta: 0.02, share: 0.25 } as const;

export default function Expert() {
  const { view } = useModel();
  return (
    <Show when={view()}>
      {(known) => (
        <>
          <Criteria view={known()} />
          <Guards view={known()} />
        </>
      )}
    </Show>
  );
}

/** The view's error, or else pixels if there are any, or what would be the same as the present tolerance. */
function errorOf(view: View, statistics: Statistics | undefined, spacing: number): number | string {
  if (view.error !== undefined) return view.error;
  const tolerance = statistics?.tolerance ?? -1;
  return view.detail === "view" || tolerance <= 0 ? FIRST_ERROR : `${Number((tolerance / spacing).toPrecision(2))}vx`;
}

function criterionEdit(by: Criterion, view: View, state: ViewerState, spacing: number): Edit {
  const { statistics } = state;
  switch (by) {
    case "error":
      // The paper's mesher knows β and budgets alone.
      return { error: errorOf(view, statistics, spacing), ...(view.mesher === "marching-cubes" ? { mesher: "dual" } : {}) };
    case "triangles":
      return budgetEdit(state, view.triangles ?? { share: FIRST.share });
    case "beta":
      return { beta: Number((statistics?.beta ?? FIRST.beta).toPrecision(3)) };
  }
}

function Criteria(props: { readonly view: View }) {
  const { actions, viewer } = useModel();
  const spacing = useSpacing();
  const statistics = () => viewer().statistics;
  const by = () => criterion(props.view, statistics(), spacing());
  return (
    <>
      <Row label="Limit by">
        <Choice<Criterion>
          label="Limit by"
          value={by()}
          options={[
            { value: "triangles", text: "Triangles", hint: "The smallest error with at most so many triangles" },
            { value: "error", text: "Error", hint: "Merge up to an error: more where importance is low" },
            { value: "beta", text: "β (paper)", hint: "Merge what is less important than β, as in the paper" },
          ]}
          onChange={(to) => actions.edit(criterionEdit(to, props.view, viewer(), spacing()))}
        />
      </Row>
      <Show when={props.view.error !== undefined}>
        <ErrorRows error={props.view.error ?? FIRST_ERROR} view={props.view} statistics={statistics()} isExceeded={by() === "triangles"} />
      </Show>
      <Show when={props.view.beta !== undefined}>
        <BetaSlider beta={props.view.beta ?? 0} />
      </Show>
    </>
  );
}

function BetaSlider(props: { readonly beta: number }) {
  const { actions } = useModel();
  return (
    <Slider
      label="β"
      value={props.beta}
      scale={BETA_SCALE}
      min={-1}
      max={1}
      step={Math.max(1e-4, Number((props.beta / 10).toPrecision(1)))}
      note={props.beta < 0 ? "full surface" : "importance up to which is merged"}
      words={props.beta < 0 ? "full surface" : `up to importance ${formatValue(props.beta)}`}
      onChange={(beta, gesture) => actions.edit({ beta }, gesture)}
      onEnd={actions.endGesture}
    />
  );
}

/** Limits on the error that are offered; another one that is in force is added. */
const ERROR_LIMITS = ["auto", "none", "0.1vx", "0.25vx", "0.5vx", "1vx"];

function errorLimitText(value: string, unit: string | undefined): string {
  if (value === "auto") return "Auto";
  if (value === "none") return "No guard";
  return value.endsWith("vx") ? `${value.slice(0, -2)} voxel` : `${value} ${unitWord(unit)}`;
}

/** The paper's mesher knows no error: the budget beside it stays, or β takes its place. */
function mesherEdit(mesher: View["mesher"], view: View): Edit {
  if (mesher === "dual" || view.error === undefined) return { mesher };
  if (view.triangles !== undefined) return { mesher, triangles: view.triangles };
  return { mesher, ...(view.bytes === undefined ? { beta: FIRST.beta } : { bytes: view.bytes }) };
}

function Guards(props: { readonly view: View }) {
  const { actions } = useModel();
  const scale = useScale();
  const limit = () => (props.view.maxError === null ? "none" : String(props.view.maxError));
  const limits = () => (ERROR_LIMITS.includes(limit()) ? ERROR_LIMITS : [...ERROR_LIMITS, limit()]);
  const guard = (value: string) => (value === "none" ? null : value === "auto" || value.endsWith("vx") ? value : Number(value));
  return (
    <>
      <Select label="Maximum error" value={limit()} options={limits().map((value) => ({ value, text: errorLimitText(value, scale().unit) }))} onChange={(value) => actions.edit({ maxError: guard(value) })} />
      <Row label="Topology">
        <Choice<View["topology"]>
          label="Topology"
          value={props.view.topology}
          options={[
            { value: "auto", text: "Auto", hint: "Nothing vanishes and nothing closes, unless a budget is too small for that" },
            { value: "preserve", text: "Preserve", hint: "Nothing vanishes and nothing closes, or the surface is refused" },
            { value: "free", text: "Free", hint: "Small parts may vanish" },
          ]}
          onChange={(topology) => actions.edit({ topology })}
        />
      </Row>
      <MesherRows view={props.view} />
    </>
  );
}

function MesherRows(props: { readonly view: View }) {
  const { actions } = useModel();
  const scale = useScale();
  const levels = Array.from({ length: LEVELS }, (_, level) => ({ value: level, text: String(level), hint: level === 0 ? "No cube is merged" : `Cubes of up to ${2 ** level} cells per axis` }));
  return (
    <>
      <Row label="Mesher">
        <Choice<View["mesher"]>
          label="Mesher"
          value={props.view.mesher}
          options={[
            { value: "dual", text: "Dual", hint: "Watertight for any cut" },
            { value: "marching-cubes", text: "Marching cubes", hint: "The paper's, cracks patched" },
          ]}
          onChange={(mesher) => actions.edit(mesherEdit(mesher, props.view))}
        />
      </Row>
      <Row label="Coarsest level">
        <Choice<number> label="Coarsest level" value={props.view.maxLevel} options={levels} onChange={(maxLevel) => actions.edit({ maxLevel })} />
      </Row>
      <Row label="Remove parts smaller than">
        <span class="with-unit">
          <NumberField label="Area below which parts are removed" value={props.view.minPart ?? 0} min={0} step={1} disabled={!cutsTree(props.view)} onChange={(minPart) => actions.edit({ minPart })} />
          <span class="unit">{scale().unit === undefined ? "area" : unitWord(scale().unit, 2)}</span>
        </span>
      </Row>
    </>
  );
}

function Row(props: { readonly label: string; readonly children: JSX.Element }) {
  return (
    <div class="control row">
      <span class="label">{props.label}</span>
      {props.children}
    </div>
  );
}
