/** The legend of a field's colours over the picture, whose two ends are dragged, moved by keys or typed. Loaded when it is first shown. */

import { createEffect, For, Show } from "solid-js";
import { COLOR_MAPS } from "../colors/maps";
import type { View } from "../protocol/types";
import { withRanges } from "../state/featureRanges";
import { coloredByLook } from "../state/surfaceList";
import { colorExpression, fieldBarOf, fieldScaleOf, valueAt, type FieldScale } from "./cards/fieldColors";
import { useDescribed } from "./expressions";
import { digitsBetween, formatValue } from "./format";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import { NumberField } from "./widgets/numberField";
import "./style/fieldLegend.css";

type End = 0 | 1;
const NAMES = ["Lowest colour", "Highest colour"] as const;
/** Shares of the range by which keys move an end. */
const KEYS: Readonly<Record<string, number>> = { ArrowUp: 0.01, ArrowRight: 0.01, ArrowDown: -0.01, ArrowLeft: -0.01, PageUp: 0.1, PageDown: -0.1 };
/** The ends stay this share of the range apart. */
const NEAREST = 0.01;
const GESTURE = "color-range";

function useFieldScale() {
  const { look, selected, surfaces, viewer, volume } = useModel();
  const view = () => coloredByLook(withRanges(viewer(), surfaces()), selected()?.number ?? 0)?.view;
  const scale = () => {
    const of = view();
    return of && fieldScaleOf(look(), of, volume());
  };
  return { view, scale };
}

/** Sets the range of an expression's colours if there is none: a link that was written by hand names none. */
function useRangeOfExpression(view: () => View | undefined) {
  const { actions, look, volume } = useModel();
  const expression = () => colorExpression(view(), volume());
  const described = useDescribed(expression);
  createEffect(() => {
    const known = described();
    if (known?.info === undefined || known.text !== expression() || look().colorRange !== undefined) return;
    const [low, high] = known.info.range;
    if (low < high) actions.changeLook({ colorRange: [low, high] });
  });
}

export default function FieldLegend() {
  const { actions, look, volume } = useModel();
  const { view, scale } = useFieldScale();
  useRangeOfExpression(view);
  const bar = () => {
    const [of, on] = [view(), scale()];
    return of && on && { scale: on, ...fieldBarOf(on, of, volume()) };
  };
  const digits = (of: FieldScale) => digitsBetween(...of.range);
  const set = (end: End, value: number, gesture?: string) => {
    const now = scale();
    if (now !== undefined) actions.changeLook({ colorRange: end === 0 ? [value, now.range[1]] : [now.range[0], value] }, gesture);
  };
  const field = (end: End, now: FieldScale) => (
    // The other end limits it, and so does what has a logarithm.
    <NumberField
      label={NAMES[end]}
      value={now.range[end]}
      digits={digits(now)}
      step={(now.range[1] - now.range[0]) / 100}
      {...(end === 0 ? { max: valueAt(now, 1 - NEAREST) } : { min: valueAt(now, NEAREST) })}
      onChange={(value) => set(end, value)}
    />
  );
  return (
    <Show when={bar()}>
      {(now) => (
        <div class="field-legend" role="group" aria-label={`Colours of ${now().title}`}>
          <b>{now().title}</b>
          {field(1, now().scale)}
          <div class="field-bar" style={{ background: `linear-gradient(to top, ${COLOR_MAPS[look().map].join(", ")})` }}>
            <For each={now().lines}>
              {({ at, text }) => (
                <span class="field-line" style={{ bottom: `${(100 * at).toFixed(2)}%` }}>
                  <span>{text}</span>
                </span>
              )}
            </For>
            <Show when={now().lines.length === 0}>
              <span class="field-line middle">
                <span>{now().texts[1]}</span>
              </span>
            </Show>
            <Handle end={1} scale={now().scale} onMove={(value) => set(1, value, GESTURE)} />
            <Handle end={0} scale={now().scale} onMove={(value) => set(0, value, GESTURE)} />
          </div>
          {field(0, now().scale)}
          <Show when={look().colorRange !== undefined}>
            <Button quiet label="Reset range of the colours" onClick={() => actions.changeLook({ colorRange: undefined })}>
              Reset
            </Button>
          </Show>
        </div>
      )}
    </Show>
  );
}

/** One end of the bar. Dragged by the bar's height, it moves by the whole range. */
function Handle(props: { readonly end: End; readonly scale: FieldScale; readonly onMove: (value: number) => void }) {
  const { actions } = useModel();
  let from: { readonly y: number; readonly height: number; readonly scale: FieldScale } | undefined;
  const move = (scale: FieldScale, share: number) => {
    const place = props.end === 0 ? Math.min(share, 1 - NEAREST) : Math.max(1 + share, NEAREST);
    props.onMove(Number(formatValue(valueAt(scale, place), digitsBetween(...scale.range) + 1)));
  };
  const begin = (event: PointerEvent & { readonly currentTarget: HTMLElement }) => {
    event.currentTarget.setPointerCapture(event.pointerId);
    from = { y: event.clientY, height: event.currentTarget.parentElement?.clientHeight ?? 1, scale: props.scale };
  };
  const drag = (event: PointerEvent) => {
    if (from !== undefined) move(from.scale, (from.y - event.clientY) / from.height);
  };
  const end = () => {
    from = undefined;
    actions.endGesture();
  };
  const onKeyDown = (event: KeyboardEvent) => {
    const share = KEYS[event.key];
    if (share === undefined) return;
    event.preventDefault();
    move(props.scale, share);
  };
  return (
    <div
      class="field-handle"
      classList={{ top: props.end === 1 }}
      role="slider"
      tabindex="0"
      aria-label={NAMES[props.end]}
      aria-orientation="vertical"
      aria-valuenow={props.scale.range[props.end]}
      aria-valuetext={formatValue(props.scale.range[props.end])}
      aria-valuemin={props.end === 0 ? Math.min(props.scale.known[0], props.scale.range[0]) : props.scale.range[0]}
      aria-valuemax={props.end === 1 ? Math.max(props.scale.known[1], props.scale.range[1]) : props.scale.range[1]}
      title="Drag, or use the arrow keys"
      on:pointerdown={begin}
      on:pointermove={drag}
      on:pointerup={end}
      on:pointercancel={end}
      on:keydown={onKeyDown}
      on:keyup={() => actions.endGesture()}
    />
  );
}
