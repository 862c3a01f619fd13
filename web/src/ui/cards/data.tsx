/** The open volume: positions of its samples, and the data of each field. */

import { createMemo, createSignal, For, Show } from "solid-js";
import type { FieldInfo, VolumeInfo } from "../../protocol/types";
import { stepCount, stepWords } from "../../state/timeSteps";
import { useModel } from "../model";
import type { CountScale } from "../plots/axis";
import { HistogramPlot } from "../plots/histogramPlot";
import { copyOut } from "../takeAlong";
import { Button } from "../widgets/button";
import { Choice, Select } from "../widgets/choice";
import { affineOf, fieldRows, volumeRows } from "./dataWords";
import { label } from "./features";
import { Rows } from "./rows";
import "../style/data.css";

/** Kept while the page is open: the card may be folded in between. */
const [chosen, setChosen] = createSignal<string>();
const [scale, setScale] = createSignal<CountScale>("log");

export default function Body() {
  const { volume } = useModel();
  return <Show when={volume()}>{(known) => <Data volume={known()} />}</Show>;
}

function Data(props: { readonly volume: VolumeInfo }) {
  const { view, viewer } = useModel();
  const step = () => (stepCount(viewer()) > 1 ? stepWords(viewer(), props.volume.step) : undefined);
  const named = (name: string | undefined) => props.volume.fields.find((field) => field.name === name);
  /** The one that was chosen, or that is shown. */
  const field = createMemo(() => named(chosen()) ?? named(view()?.field) ?? props.volume.fields[0]);
  const notices = () => props.volume.notice?.split("\n") ?? [];
  return (
    <>
      <Rows rows={volumeRows(props.volume, step())} />
      <Matrix geometry={props.volume.geometry} />
      <Show when={field()}>{(known) => <Field field={known()} volume={props.volume} />}</Show>
      <Show when={notices().length > 0}>
        <h3>Notices</h3>
        <ul class="notices">
          <For each={notices()}>{(text) => <li>{text}</li>}</For>
        </ul>
      </Show>
    </>
  );
}

function Matrix(props: { readonly geometry: VolumeInfo["geometry"] }) {
  const model = useModel();
  const rows = () => affineOf(props.geometry);
  const copy = () => void copyOut(model, [...rows(), ["0", "0", "0", "1"]].map((row) => row.join(" ")).join("\n"), "Matrix copied");
  return (
    <details class="fold matrix">
      <summary>Matrix from sample indices to the world</summary>
      <table aria-label="Matrix from sample indices to the world">
        <tbody>
          <For each={rows()}>
            {(row) => (
              <tr>
                <For each={row}>{(value) => <td>{value}</td>}</For>
              </tr>
            )}
          </For>
        </tbody>
      </table>
      <Button quiet onClick={copy}>
        Copy 4 × 4
      </Button>
    </details>
  );
}

function Field(props: { readonly field: FieldInfo; readonly volume: VolumeInfo }) {
  const { surfaces } = useModel();
  const unit = () => props.field.unit ?? undefined;
  const marks = () => surfaces().flatMap(({ view, style }) => (view.field === props.field.name && style.visible ? [{ value: view.iso, color: style.color }] : []));
  const options = () => props.volume.fields.map(({ name }) => ({ value: name, text: label(name) }));
  return (
    <>
      <div class="control row data-field">
        <Show when={options().length > 1} fallback={<h3>{label(props.field.name)}</h3>}>
          <Select label="Field of the data" hideLabel value={props.field.name} options={options()} onChange={setChosen} />
        </Show>
        <Choice<CountScale>
          label="Scale of the counts"
          value={scale()}
          options={[
            { value: "log", text: "Log", hint: "Rare values are seen too" },
            { value: "linear", text: "Linear", hint: "Heights are in proportion to counts" },
          ]}
          onChange={setScale}
        />
      </div>
      <HistogramPlot histogram={props.field.histogram} scale={scale()} unit={unit()} marks={marks()} />
      <Rows rows={fieldRows(props.field, props.volume.geometry)} />
    </>
  );
}
