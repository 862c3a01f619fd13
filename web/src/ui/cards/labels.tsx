/** Labels of a segmentation: the surface of each, importance around it, a mask to it, its area and volume. */

import { createMemo, createSignal, For, Match, Show, Switch } from "solid-js";
import type { FieldInfo } from "../../protocol/types";
import type { Enclosed } from "../../state/enclosed";
import { importanceEdit, isAround, joinedLabel, labelByNumber, labelFields, labelsAround, labelsIn, labelsKept, labelsName, labelsNear, maskEdit, matching, samplesVolume, shownLabel, smoothedLabels, SMOOTHING, surfacesAround, type LabelEntry } from "../../state/labels";
import { lengthUnit } from "../../state/lengths";
import { listHas } from "../../state/mask";
import type { Surface } from "../../state/surfaceList";
import { formatCount } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Select, Toggle } from "../widgets/choice";
import { Icon } from "../widgets/icon";
import { amountText, enclosedRows } from "./enclosedWords";
import { label as fieldText } from "./features";
import { LabelList, type LabelSwitch } from "./labelList";
import "../style/labels.css";

/** A list that is longer has a field to search it. */
const MANY = 12;

/** Kept while the page is open: the card may be folded in between. */
const [chosen, setChosen] = createSignal("");
const [sought, setSought] = createSignal("");
const [wantsSmooth, setSmooth] = createSignal<boolean>();

/** Smoothing is computed on the host, from all samples: of many only if the user asks. */
const MAX_SMOOTHED = 2 ** 26;

/** Whether surfaces around labels are smoothed: as those that there are, or as the user has chosen. */
function isSmooth({ surfaces, volume }: ReturnType<typeof useModel>): boolean {
  const known = surfaces().map(({ view }) => labelsAround(view.field)).find((of) => of !== undefined);
  if (known !== undefined) return known.smoothing > 0;
  const { dims = [] } = volume()?.geometry ?? {};
  return wantsSmooth() ?? dims.reduce((all: number, n) => all * n, 1) <= MAX_SMOOTHED;
}

export default function Body() {
  const { volume } = useModel();
  const fields = () => labelFields(volume());
  const field = createMemo(() => fields().find(({ name }) => name === chosen()) ?? fields()[0]);
  return (
    <>
      <Show when={fields().length > 1}>
        <Select label="Labels of" value={field()?.name} options={fields().map(({ name }) => ({ value: name, text: fieldText(name) }))} onChange={setChosen} />
      </Show>
      <Show when={field()}>{(known) => <Labels field={known()} />}</Show>
    </>
  );
}

function Labels(props: { readonly field: FieldInfo }) {
  const model = useModel();
  const { volume } = model;
  const all = createMemo(() => {
    const geometry = volume()?.geometry;
    return geometry === undefined ? [] : labelsIn(props.field, geometry);
  });
  const found = createMemo(() => {
    const labels = all().length > MANY || all().length === 0 ? matching(all(), sought()) : all();
    const typed = labels.length === 0 ? labelByNumber(props.field, sought()) : undefined;
    return typed === undefined ? labels : [typed];
  });
  const switches = useSwitches(() => props.field.name, all);
  const note = ({ samples }: LabelEntry) => {
    const geometry = volume()?.geometry;
    const size = samples === undefined || geometry === undefined ? undefined : samplesVolume(samples, geometry);
    return size === undefined ? "" : amountText(size, lengthUnit(volume()), 3);
  };
  return (
    <>
      <Show when={all().length > MANY || all().length === 0}>
        <Search count={found().length} of={all().length} />
      </Show>
      <Show when={found().length > 0} fallback={<p class="note">{all().length === 0 ? "The file has no table of labels: type the number of one" : "No label has this name or number"}</p>}>
        <LabelList labels={found()} switches={switches()} note={note} />
        <p class="note label-legend" aria-hidden="true">
          <For each={switches()}>
            {({ icon, short }) => (
              <span>
                <Icon name={icon} /> {short}
              </span>
            )}
          </For>
        </p>
      </Show>
      <Foot field={props.field.name} />
    </>
  );
}

function Search(props: { readonly count: number; readonly of: number }) {
  return (
    <div class="control row label-search">
      <input class="text" type="search" autocomplete="off" spellcheck={false} aria-label="Search labels" placeholder={props.of === 0 ? "Number of a label" : "Name or number"} value={sought()} on:input={(event) => setSought(event.currentTarget.value)} />
      <span class="note" role="status">
        {props.of === 0 ? "" : props.count === props.of ? formatCount(props.of) : `${formatCount(props.count)} of ${formatCount(props.of)}`}
      </span>
    </div>
  );
}

/** What can be done with each label of a field. */
function useSwitches(field: () => string, all: () => readonly LabelEntry[]): () => readonly LabelSwitch[] {
  const model = useModel();
  const { actions, extent, surfaces, view } = model;
  const surface: LabelSwitch = {
    icon: "look",
    offIcon: "hidden",
    short: "surface",
    text: ({ name }) => `Surface of ${name}`,
    isOn: ({ number }) => surfacesAround(surfaces(), field(), number).some(({ style }) => style.visible),
    onClick: (label) => showLabel(model, field(), label),
  };
  const importance: LabelSwitch = {
    icon: "matters",
    short: "fine near it",
    text: ({ name }) => `Importance falls with the distance to ${name}`,
    isOn: ({ number }) => listHas(labelsNear(view()?.feature ?? "", field()), number),
    onClick: (label) => actions.editByOpening((now, opening) => importanceEdit(now, field(), label, all(), { opening, extent: extent() })),
  };
  const mask: LabelSwitch = {
    icon: "mask",
    short: "restrict to it",
    text: ({ name }) => `Restrict the surface to ${name}`,
    isOn: ({ number }) => listHas(labelsKept(view()?.mask ?? null, field()), number),
    onClick: (label) => actions.editByOpening((now) => maskEdit(now, field(), label, all())),
  };
  /** Cells that touch samples outside have no surface: that around labels would vanish with a mask to them. */
  const offersMask = () => {
    const name = view()?.field ?? "";
    return name !== field() && labelsAround(name)?.field !== field();
  };
  return () => (offersMask() ? [surface, importance, mask] : [surface, importance]);
}

/** Shows or hides the surface of a label; if there is no place for a further surface, asks whether another one shall be around it too. */
function showLabel(model: ReturnType<typeof useModel>, field: string, label: LabelEntry): void {
  const { actions, surfaces } = model;
  const of = { field, label, smoothing: isSmooth(model) ? SMOOTHING : 0, max: model.viewer().maxSurfaces };
  const found = { isFull: false };
  actions.arrangeSurfaces((list, opening) => {
    const shown = shownLabel(list, { ...of, opening });
    found.isFull = shown === undefined;
    return shown;
  });
  if (!found.isFull) return;
  const full = `There are ${surfaces().length} surfaces, the maximum`;
  if (joinedLabel(surfaces(), of) === undefined) model.toast(`${full}: remove one under Surface`, "brief");
  else model.ask(`${full}. Show ${label.name} in the last one too, in its colour?`, [{ text: "Show", act: () => actions.arrangeSurfaces((list) => joinedLabel(list, of)) }]);
}

/** Whether a surface is on screen as it is going to stay, so that it can be summed up. */
function useReady(): (surface: Surface) => boolean {
  const { facts, viewer } = useModel();
  return ({ number }) => !facts().busy && viewer().known.get(number)?.shown !== undefined;
}

/** Smoothing, and area and volume of the surfaces that are shown. */
function Foot(props: { readonly field: string }) {
  const model = useModel();
  const { actions, surfaces } = model;
  const isReady = useReady();
  const shown = () => surfaces().filter(({ view, style }) => style.visible && labelsAround(view.field)?.field === props.field);
  const known = () => model.sums?.known() ?? new Map<number, never>();
  const smooth = (on: boolean) => {
    setSmooth(on);
    actions.arrangeSurfaces((list) => (list.some(isAround) ? smoothedLabels(list, on ? SMOOTHING : 0) : undefined));
  };
  return (
    <>
      <Toggle label="Smooth surfaces" on={isSmooth(model)} onChange={smooth} />
      <Show when={shown().length > 0}>
        <div class="label-sums" role="status">
          <Show when={shown().every(({ number }) => !known().has(number))} fallback={<Sums surfaces={shown()} />}>
            <div class="control row">
              <span class="label">Area and volume</span>
              <Button disabled={!shown().some(isReady)} onClick={() => model.sums?.sum(shown().map(({ number }) => number))}>
                Compute
              </Button>
            </div>
          </Show>
        </div>
      </Show>
    </>
  );
}

function Sums(props: { readonly surfaces: readonly Surface[] }) {
  const model = useModel();
  const { volume } = model;
  const isReady = useReady();
  const sumsOf = ({ number }: Surface) => model.sums?.known().get(number);
  const columns = (sums: Enclosed) => enclosedRows(sums, lengthUnit(volume())).map(([, text]) => text).reverse();
  return (
    <table>
      <thead>
        <tr>
          <th scope="col">Surface</th>
          <th scope="col">Volume</th>
          <th scope="col">Area</th>
        </tr>
      </thead>
      <tbody>
        <For each={props.surfaces}>
          {(surface) => (
            <tr>
              <th scope="row">
                <i class="swatch" style={{ background: surface.style.color ?? "transparent" }} />
                <span>{labelsName(volume(), surface.view.field)}</span>
              </th>
              <Switch>
                <Match when={sumsOf(surface) === "summing"}>
                  <td colspan={2}>Computing</td>
                </Match>
                <Match when={sumsOf(surface) === undefined}>
                  <td colspan={2}>
                    <Button quiet disabled={!isReady(surface)} onClick={() => model.sums?.sum([surface.number])}>
                      Compute
                    </Button>
                  </td>
                </Match>
                <Match when={sumsOf(surface)}>{(sums) => <For each={columns(sums() as Enclosed)}>{(text) => <td>{text}</td>}</For>}</Match>
              </Switch>
            </tr>
          )}
        </For>
      </tbody>
    </table>
  );
}
