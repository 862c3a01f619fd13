/** Which isosurfaces are shown: field and isovalue of each, and how it looks. */

import { createMemo, createSignal, For, Show, type JSX } from "solid-js";
import type { FieldInfo } from "../../protocol/types";
import { fieldEdit } from "../../state/fields";
import { labelsName } from "../../state/labels";
import { unitsOf } from "../../state/typedNumber";
import { useDescribed } from "../expressions";
import { digitsBetween, formatValue } from "../format";
import { useModel } from "../model";
import { Needs } from "../needs";
import { hasValues } from "../plots/histogram";
import { HistogramSlider } from "../plots/histogramSlider";
import { landmarks } from "../plots/landmarks";
import { Select } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { placeOf, surfaceName } from "../surfaceNames";
import type { Card } from "./card";
import { ExpressionEditor } from "./expressionEditor";
import { label } from "./features";
import { broughtIsovalue, SurfaceRows } from "./surfaceRows";

/** Explains why a field opens with this isovalue; empty if `iso` is another one. */
export function openingText(field: FieldInfo | undefined, iso: number): string {
  const opening = field?.openingIso;
  // A line break never separates a number from its per cent sign.
  return opening?.iso === iso ? `Default: ${opening.explanation.replaceAll(" %", "\u00a0%")}` : "";
}

function Body() {
  const model = useModel();
  const { actions, view, volume } = model;
  const fields = () => volume()?.fields ?? [];
  const [editing, setEditing] = createSignal(false);
  const named = (name: string | undefined) => fields().find((known) => known.name === name);
  /** The expression whose surface is shown. */
  const expression = () => {
    const name = view()?.field;
    return fields().length === 0 || name === undefined || named(name) !== undefined ? undefined : name;
  };
  const described = useDescribed(expression);
  const isEditing = () => editing() || (expression() !== undefined && described()?.info === undefined);
  const field = createMemo(() => named(view()?.field) ?? described()?.info);
  const choose = (name: string) => {
    const [now, inForce] = [volume(), view()];
    if (now !== undefined && inForce !== undefined) actions.edit(fieldEdit(now, inForce, name));
  };
  const use = (info: FieldInfo) => {
    actions.edit({ field: info.name, iso: info.openingIso?.iso ?? view()?.iso ?? 0 });
  };
  const options = () => [...fields().map(({ name }) => name), ...(expression() === undefined ? [] : [expression() ?? ""])].map((name) => ({ value: name, text: labelsName(volume(), name) ?? label(name) }));
  return (
    <>
    <Show when={field()}>
      {(known) => (
        <>
          <Needs role="edit">
            <Isovalue field={known()} iso={view()?.iso ?? 0}>
              <Show when={options().length > 1} fallback={<span class="label">Isovalue</span>}>
                <Select label="Field" hideLabel value={view()?.field} options={options()} onChange={choose} />
              </Show>
            </Isovalue>
          </Needs>
          <SurfaceRows>
            <Show when={model.may("edit") && !isEditing()}>
              <Compute isChange={expression() !== undefined} onClick={() => setEditing(true)} />
            </Show>
          </SurfaceRows>
        </>
      )}
    </Show>
    <Show when={model.may("edit") && isEditing()}>
      <ExpressionEditor label="Expression of the field" value={expression() ?? ""} onUse={use} onClose={() => setEditing(false)} />
    </Show>
    </>
  );
}

/** One word: beside the other buttons it takes no line of its own, for which a small window has no place. */
function Compute(props: { readonly isChange: boolean; readonly onClick: () => void }) {
  return (
    <button type="button" class="button quiet" aria-label={props.isChange ? "Change the expression…" : "Compute a field…"} title="A field computed from others, by an expression" on:click={() => props.onClick()}>
      {props.isChange ? "Change" : "Compute"}
    </button>
  );
}

function Isovalue(props: { readonly field: FieldInfo; readonly iso: number; readonly children: JSX.Element }) {
  const { actions, selected, surfaces } = useModel();
  const unit = () => props.field.unit ?? undefined;
  const several = () => surfaces().length > 1;
  /** Of the surfaces of this field. */
  const handles = () =>
    surfaces().flatMap(({ number, view, style }) => {
      if (view.field !== props.field.name) return [];
      const of = { number, value: view.iso, color: style.color };
      return [several() ? { ...of, label: `Isovalue of ${surfaceName(surfaces(), number)}`, mark: String(placeOf(surfaces(), number)) } : { ...of, color: undefined, label: "Isovalue", mark: "" }];
    });
  const range = () => props.field.histogram.max - props.field.histogram.min;
  const digits = () => digitsBetween(props.field.histogram.min, props.field.histogram.max);
  const axisNote = () => {
    if (!(range() > 0)) return hasValues(props.field) ? "All values are equal: there is no surface" : "No sample has a value: there is no surface";
    return several() ? "" : openingText(props.field, props.iso);
  };
  return (
    <div class="control">
      <div class="control-head">
        {props.children}
        <span class="spring" />
        <Show when={!several()}>
          <NumberField label="Isovalue" value={props.iso} digits={digits() + 1} step={range() / 256 || 1} units={unitsOf(unit())} onChange={(iso) => actions.edit({ iso })} />
          <span class="unit">{unit()}</span>
        </Show>
      </div>
      <HistogramSlider
        histogram={props.field.histogram}
        handles={handles()}
        selected={selected()?.number ?? 0}
        unit={unit()}
        onSelect={actions.selectSurface}
        onChange={(iso) => actions.edit({ iso }, "iso")}
        onEnd={actions.endGesture}
      />
      <div class="axis-labels">
        <span>{formatValue(props.field.histogram.min, digits())}</span>
        <span>{axisNote()}</span>
        <span>{formatValue(props.field.histogram.max, digits())}</span>
      </div>
      <Landmarks field={props.field} iso={props.iso} />
    </div>
  );
}

/** Isovalues worth trying, as buttons. */
function Landmarks(props: { readonly field: FieldInfo; readonly iso: number }) {
  const { actions, volume } = useModel();
  const marks = createMemo(() => landmarks(props.field, broughtIsovalue(volume(), props.field.name)));
  return (
    <div class="chips" role="group" aria-label="Isovalues worth trying">
      <For each={marks()}>
        {(mark) => (
          <button type="button" class="chip" aria-pressed={mark.iso === props.iso} title={mark.why} on:click={() => actions.edit({ iso: mark.iso })}>
            {mark.name}
          </button>
        )}
      </For>
    </div>
  );
}

export const surfaceCard: Card = { id: "surface", title: "Surface", icon: "surface", body: Body };
