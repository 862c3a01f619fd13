/** Where the surface may be: everywhere, or where another field has certain values. */

import { Show } from "solid-js";
import { COMPARISONS, firstMask, maskText, plainValue, readMask, refusedValues, takesList, type Comparison, type Mask } from "../../state/mask";
import { useModel } from "../model";
import { Select } from "../widgets/choice";
import { TextField } from "../widgets/textField";
import { label } from "./features";

const EVERYWHERE = "";
const COMPARISON_OPTIONS = COMPARISONS.map(({ symbol, text }) => ({ value: symbol, text }));

export function MaskTools(props: { readonly mask: string | null }) {
  const { actions, volume } = useModel();
  const mask = () => (props.mask === null ? undefined : readMask(props.mask));
  const fields = () => volume()?.fields ?? [];
  const choose = (name: string) => {
    const field = fields().find((known) => known.name === name);
    actions.edit({ mask: field === undefined ? null : maskText(firstMask(name, field)) });
  };
  const options = () => [{ value: EVERYWHERE, text: "Everywhere" }, ...fields().map(({ name }) => ({ value: name, text: label(name) }))];
  return (
    <div class="mask">
      <Select label="Only where" value={mask()?.field ?? EVERYWHERE} options={options()} onChange={choose} />
      <Show when={mask()}>{(known) => <Values mask={known()} />}</Show>
    </div>
  );
}

function Values(props: { readonly mask: Mask }) {
  const { actions } = useModel();
  const edit = (change: Partial<Mask>) => actions.edit({ mask: maskText({ ...props.mask, ...change }) });
  /** Of a list the first number stays, where the new comparison takes one alone. */
  const compare = (symbol: string) => {
    const comparison = symbol as Comparison;
    const { values } = props.mask;
    edit({ comparison, values: takesList(comparison) ? values : (values.split(/,|\.\./)[0] ?? values).trim() });
  };
  return (
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
  );
}
