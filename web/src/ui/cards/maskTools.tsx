/** Mask of the surface: none, or the samples at which another field has certain values. */

import { For, Show } from "solid-js";
import { COMPARISONS, firstMask, listHas, maskText, plainValue, readMask, refusedValues, takesList, toggled, type Comparison, type Mask } from "../../state/mask";
import { useModel } from "../model";
import { Select } from "../widgets/choice";
import { TextField } from "../widgets/textField";
import { label } from "./features";

const EVERYWHERE = "";
/** Labels with a button; others are typed. */
const MAX_CHIPS = 64;
const COMPARISON_OPTIONS = COMPARISONS.map(({ symbol, text }) => ({ value: symbol, text }));

export function MaskTools(props: { readonly mask: string | null }) {
  const { actions, volume } = useModel();
  const mask = () => (props.mask === null ? undefined : readMask(props.mask));
  const fields = () => volume()?.fields ?? [];
  const choose = (name: string) => {
    const field = fields().find((known) => known.name === name);
    actions.edit({ mask: field === undefined ? null : maskText(firstMask(name, field)) });
  };
  const options = () => [{ value: EVERYWHERE, text: "Whole volume" }, ...fields().map(({ name }) => ({ value: name, text: label(name) }))];
  return (
    <div class="mask">
      <Select label="Restrict to" value={mask()?.field ?? EVERYWHERE} options={options()} onChange={choose} />
      <Show when={mask()}>{(known) => <Values mask={known()} />}</Show>
    </div>
  );
}

function Values(props: { readonly mask: Mask }) {
  const { actions, volume } = useModel();
  const edit = (change: Partial<Mask>) => actions.edit({ mask: maskText({ ...props.mask, ...change }) });
  /** Changes the comparison. If the new one takes a single value, keeps only the first number of a list. */
  const compare = (symbol: string) => {
    const comparison = symbol as Comparison;
    const { values } = props.mask;
    edit({ comparison, values: takesList(comparison) ? values : (values.split(/,|\.\./)[0] ?? values).trim() });
  };
  const labels = () => (takesList(props.mask.comparison) ? (volume()?.fields.find(({ name }) => name === props.mask.field)?.labels ?? []) : []);
  const toggle = (value: number) => {
    const values = toggled(props.mask.values, value, labels().map((label) => label.value));
    // A list has at least one value.
    if (values !== "") edit({ values });
  };
  return (
    <>
    <div class="control row mask-values">
      <Select label="How its values compare" hideLabel value={props.mask.comparison} options={COMPARISON_OPTIONS} onChange={compare} />
      <TextField
        label="Values of the mask"
        value={props.mask.values}
        placeholder={takesList(props.mask.comparison) ? "1, 4..7" : "0.5"}
        refused={(text) => refusedValues(props.mask.comparison, text)}
        onChange={(values) => edit({ values: takesList(props.mask.comparison) ? values : plainValue(values) })}
      />
    </div>
    <Show when={labels().length > 0}>
      <div class="chips mask-labels" role="group" aria-label="Labels of the mask">
        <For each={labels().slice(0, MAX_CHIPS)}>
          {({ value, name }) => (
            <button type="button" class="chip" aria-pressed={listHas(props.mask.values, value)} title={`Label ${value}`} on:click={() => toggle(value)}>
              {name ?? String(value)}
            </button>
          )}
        </For>
        <Show when={labels().length > MAX_CHIPS}>
          <span class="note">and {labels().length - MAX_CHIPS} more, by number</span>
        </Show>
      </div>
    </Show>
    </>
  );
}
