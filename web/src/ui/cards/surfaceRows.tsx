/** The list of surfaces, how the selected one looks, which of its parts are shown, and the button for a further one. */

import { createSignal, Index, Show, type JSX } from "solid-js";
import { labelsName } from "../../state/labels";
import { freeColor, MAX_SURFACES, type Surface } from "../../state/surfaceList";
import type { SurfaceState } from "../../state/surfaceState";
import { unitsOf } from "../../state/typedNumber";
import type { VolumeInfo } from "../../protocol/types";
import { digitsBetween, formatCount } from "../format";
import { useModel } from "../model";
import { furtherIsovalue } from "../plots/landmarks";
import { inkOn, surfaceName, useSurfaceName } from "../surfaceNames";
import { Button, IconButton } from "../widgets/button";
import { Choice } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider, type Scale } from "../widgets/slider";
import { label } from "./features";
import { MaskTools } from "./maskTools";
import { offersParts, PartTools } from "./partTools";

const OPACITY_SCALE: Scale = { toValue: (t) => Math.round(100 * t) / 100, toPosition: (opacity) => opacity };

/** The isovalue that the volume brings along is that of its main field. */
export function broughtIsovalue(volume: VolumeInfo | undefined, field: string): number | undefined {
  return volume?.fields[0]?.name === field ? volume.opening?.iso : undefined;
}

/** Whether a panel is open, and a function that toggles it. Until the user toggles it, it is open if it has content. */
function createPanel(hasContent: () => boolean): readonly [isOpen: () => boolean, toggle: () => void] {
  const [wish, setWish] = createSignal<boolean>();
  const isOpen = () => wish() ?? hasContent();
  return [isOpen, () => setWish(!isOpen())];
}

/** `children` come before the other buttons. */
export function SurfaceRows(props: { readonly children: JSX.Element }) {
  const model = useModel();
  const { selected, surfaces, view, viewer, volume } = model;
  const several = () => surfaces().length > 1;
  /** A surface alone that is hidden is listed too: else nothing would show it again. */
  const isListed = () => several() || surfaces().some(({ style }) => !style.visible);
  const most = () => Math.min(MAX_SURFACES, viewer().maxSurfaces);
  const isFull = () => surfaces().length >= most();
  const selectedName = useSurfaceName();
  const note = () => {
    if (isFull() && most() > 1) return `Maximum of ${most()} surfaces`;
    return several() ? `Editing ${selectedName()}` : "";
  };
  const [isOpen, toggleOpen] = createPanel(several);
  const [isPartsOpen, togglePartsOpen] = createPanel(() => (view()?.parts ?? null) !== null);
  const [isMaskOpen, toggleMaskOpen] = createPanel(() => (view()?.mask ?? null) !== null);
  /** A mask is another field of the same volume. */
  const offersMask = () => model.may("edit") && (volume()?.fields.length ?? 0) > 1;
  const offersPartTools = () => model.may("edit") && offersParts(selected()?.view, viewer().questions);
  return (
    <Show when={surfaces().length > 0}>
      <Show when={isListed()}>
        <ul class="surfaces" aria-label="Surfaces">
          <Index each={surfaces()}>{(surface, place) => <Item surface={surface()} place={place} isOpen={isOpen()} />}</Index>
        </ul>
      </Show>
      <Show when={isOpen() && !isListed()}>
        <Style />
      </Show>
      <div class="foot">
        <Show when={note()}>
          <span class="note">{note()}</span>
        </Show>
        {props.children}
        <Show when={offersPartTools()}>
          <button type="button" class="button quiet" aria-label="Parts of the surface" title="Hide pieces, or keep one alone" aria-expanded={isPartsOpen()} on:click={togglePartsOpen}>
            Parts
          </button>
        </Show>
        <Show when={offersMask()}>
          <button type="button" class="button quiet" aria-label="Mask of the surface" title="Restrict the surface to where another field has certain values" aria-expanded={isMaskOpen()} on:click={toggleMaskOpen}>
            Mask
          </button>
        </Show>
        <button type="button" class="button quiet" aria-label="Opacity and colour" aria-expanded={isOpen()} on:click={toggleOpen}>
          Opacity
        </button>
        <Show when={!isFull() && model.may("edit")}>
          <Add />
        </Show>
      </div>
      <Show when={isPartsOpen() && offersPartTools()}>
        <PartTools parts={view()?.parts ?? null} />
      </Show>
      <Show when={offersMask() && isMaskOpen()}>
        <MaskTools mask={view()?.mask ?? null} />
      </Show>
    </Show>
  );
}

/** How it looks is shown below the selected one. */
function Item(props: { readonly surface: Surface; readonly place: number; readonly isOpen: boolean }) {
  const { selected } = useModel();
  const isSelected = () => selected()?.number === props.surface.number;
  return (
    <li classList={{ selected: isSelected() }}>
      <Row surface={props.surface} place={props.place} isSelected={isSelected()} />
      <Show when={isSelected() && props.isOpen}>
        <Style />
      </Show>
    </li>
  );
}

function Row(props: { readonly surface: Surface; readonly place: number; readonly isSelected: boolean }) {
  const model = useModel();
  const { actions, facts, surfaces, viewer, volume } = model;
  const number = () => props.surface.number;
  const name = () => surfaceName(surfaces(), number()) || "the surface";
  const style = () => props.surface.style;
  const field = () => volume()?.fields.find(({ name }) => name === props.surface.view.field);
  const ends = () => [field()?.histogram.min ?? 0, field()?.histogram.max ?? 1] as const;
  const range = () => ends()[1] - ends()[0];
  const triangles = () => (facts().levelTrianglesBySurface[number()] ?? []).reduce((sum, n) => sum + n, 0);
  const words = () => rowText(viewer().known.get(number()), triangles());
  const labelled = () => labelsName(volume(), props.surface.view.field);
  const fieldName = () => labelled() ?? label(props.surface.view.field);
  const colors = () => {
    const { color } = style();
    return color === undefined ? {} : { background: color, color: inkOn(color), "border-color": color };
  };
  const change = (iso: number) => {
    actions.selectSurface(number());
    actions.edit({ iso });
  };
  return (
    <div class="surface-row" classList={{ faint: !style().visible }}>
      <button type="button" class="surface-disc" style={colors()} aria-label={`Select ${name()}`} aria-pressed={props.isSelected} title="The cards are about the selected surface" on:click={() => actions.selectSurface(number())}>
        {props.place + 1}
      </button>
      <Show when={labelled() === undefined} fallback={<span class="clipped">{labelled()}</span>}>
        <NumberField label={`Isovalue of ${name()}`} value={props.surface.view.iso} digits={digitsBetween(...ends()) + 1} step={range() / 256 || 1} units={unitsOf(field()?.unit)} disabled={!model.may("edit")} onChange={change} />
        <span class="unit">{field()?.unit ?? ""}</span>
      </Show>
      <span class="note clipped" title={`${fieldName()}, ${formatCount(triangles())} triangles`}>
        <Show when={(volume()?.fields.length ?? 1) > 1 && labelled() === undefined}>{label(props.surface.view.field)} · </Show>
        {words()}
      </span>
      <IconButton
        icon={style().visible ? "look" : "hidden"}
        label={style().visible ? `Hide ${name()}` : `Show ${name()}`}
        onClick={() => actions.changeStyle(number(), { visible: !style().visible })}
      />
      <Show when={surfaces().length > 1 && model.may("edit")}>
        <IconButton icon="close" label={`Remove ${name()}`} onClick={() => remove(() => actions.removeSurface(number()))} />
      </Show>
    </div>
  );
}

/** What there is of a surface: `1,234 △`, or why there is nothing. */
export function rowText(state: Pick<SurfaceState, "refusal" | "shown"> | undefined, triangles: number): string {
  if (state?.refusal !== undefined) return "refused";
  return triangles === 0 && state?.shown?.final === true ? "no surface" : `${formatCount(triangles)} △`;
}

/** The button goes with its row: the focus goes to what adds a surface again. */
function remove(act: () => void): void {
  act();
  document.querySelector<HTMLElement>(".add-surface")?.focus();
}

/** How the selected surface looks. */
function Style() {
  const { actions, selected, surfaces } = useModel();
  const name = () => surfaceName(surfaces(), selected()?.number) || "the surface";
  return (
    <Show when={selected()}>
      {(surface) => (
        <>
          <div class="control row">
            <span class="label">Colour</span>
            <span class="inline">
              <Choice<string>
                label={`Colour of ${name()}`}
                value={surface().style.color === undefined ? "look" : "own"}
                options={[
                  { value: "look", text: "Shared", hint: "The material or colours of Look, as all surfaces" },
                  { value: "own", text: "Custom", hint: "A single colour of this surface" },
                ]}
                onChange={(by) => actions.changeStyle(surface().number, { color: by === "own" ? freeColor(surfaces()) : undefined })}
              />
              <Show when={surface().style.color}>
                {(color) => (
                  <input
                    type="color"
                    aria-label={`Own colour of ${name()}`}
                    value={color()}
                    on:input={(event) => actions.changeStyle(surface().number, { color: event.currentTarget.value }, "colour")}
                    on:change={() => actions.endGesture()}
                  />
                )}
              </Show>
            </span>
          </div>
          <Opacity surface={surface()} name={name()} />
        </>
      )}
    </Show>
  );
}

function Opacity(props: { readonly surface: Surface; readonly name: string }) {
  const { actions } = useModel();
  const percent = () => Math.round(100 * props.surface.style.opacity);
  const change = (opacity: number, gesture?: string) => actions.changeStyle(props.surface.number, { opacity }, gesture);
  return (
    <Slider
      label={`Opacity of ${props.name}`}
      ends={["Transparent", "Opaque"]}
      value={props.surface.style.opacity}
      scale={OPACITY_SCALE}
      words={`${percent()} percent`}
      field={
        <>
          <NumberField label={`Opacity of ${props.name}, percent`} value={percent()} min={0} max={100} hundredPercent={100} step={5} onChange={(n) => change(n / 100)} />
          <span class="unit">%</span>
        </>
      }
      onChange={change}
      onEnd={actions.endGesture}
    />
  );
}

function Add() {
  const { actions, selected, surfaces, volume } = useModel();
  const add = () => {
    const field = selected()?.view.field ?? "";
    const info = volume()?.fields.find(({ name }) => name === field);
    const taken = surfaces().flatMap(({ view }) => (view.field === field ? [view.iso] : []));
    if (info === undefined) return;
    actions.addSurface(furtherIsovalue(info, broughtIsovalue(volume(), field), taken));
    // With the last one that there can be, this button goes, and the focus with it.
    if (document.querySelector(".add-surface") === null) document.querySelector<HTMLElement>(".surface-disc[aria-pressed=true]")?.focus();
  };
  return (
    <Button class="add-surface" quiet onClick={add}>
      Add a surface
    </Button>
  );
}
