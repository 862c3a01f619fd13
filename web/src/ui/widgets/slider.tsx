/** A labelled slider with a number field beside it. The browser's own slider: it works with mouse, touch and readers of the screen; arrow keys move to the next value that differs. */

import { createUniqueId, For, Show, type JSX } from "solid-js";
import type { NumberKind } from "../../state/typedNumber";
import { formatValue } from "../format";
import { NumberField } from "./numberField";

/** Maps a slider's position, 0 to 1, to values and back. */
export interface Scale {
  readonly toValue: (position: number) => number;
  readonly toPosition: (value: number) => number;
}

export const LINEAR: Scale = { toValue: (t) => t, toPosition: (v) => v };

/** Of a slider whose values are not counted. */
const STEPS = 1000;

/** Steps by which keys move it; ten times as many with Shift. */
const KEYS: Readonly<Record<string, number>> = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };
const FAST = 10;

/**
 * The value that a key moves to: values are rounded, so a step may have to be longer for another one. `undefined` at the end.
 * @param from position now, of 0 to `steps`
 */
export function valueAfter(scale: Scale, value: number, from: number, by: number, steps: number): number | undefined {
  for (let to = from + by; ; to += Math.sign(by)) {
    const inside = Math.min(steps, Math.max(0, to));
    const next = scale.toValue(inside / steps);
    if (next !== value) return next;
    if (inside !== to) return undefined;
  }
}

/** Of its number: bounds, and how it may be typed. */
export interface SliderProps extends NumberKind {
  readonly label: string;
  readonly value: number;
  readonly scale: Scale;
  /** Number of steps between the ends, if values are counted. */
  readonly steps?: number;
  /** What the value means, for readers of the screen. */
  readonly words?: string | undefined;
  readonly note?: string | undefined;
  /** What lies at the two ends: all of it is in one row then. */
  readonly ends?: readonly [string, string];
  readonly ticks?: readonly { readonly at: number; readonly text: string }[];
  /** A plot over the slider, on its axis. */
  readonly plot?: JSX.Element;
  readonly disabled?: boolean;
  /** In place of the number field that shows the slider's value. */
  readonly field?: JSX.Element;
  readonly step?: number;
  readonly onChange: (value: number, gesture?: string) => void;
  /** The drag is over. */
  readonly onEnd: () => void;
}

export function Slider(props: SliderProps) {
  const id = createUniqueId();
  const steps = () => Math.max(1, props.steps ?? STEPS);
  const position = () => Math.round(Math.min(1, Math.max(0, props.scale.toPosition(props.value))) * steps());
  const onKey = (event: KeyboardEvent) => {
    const by = KEYS[event.key];
    if (by === undefined || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const next = valueAfter(props.scale, props.value, position(), event.shiftKey ? FAST * by : by, steps());
    if (next === undefined) return;
    props.onChange(next, props.label);
    props.onEnd();
  };
  const track = () => (
    <input
      id={id}
      type="range"
      min={0}
      max={steps()}
      step={1}
      disabled={props.disabled ?? false}
      aria-valuetext={props.words ?? formatValue(props.value)}
      style={{ "--fill": `${(100 * position()) / steps()}%` }}
      value={String(position())}
      on:input={(event) => props.onChange(props.scale.toValue(Number(event.currentTarget.value) / steps()), props.label)}
      on:change={() => props.onEnd()}
      on:keydown={onKey}
    />
  );
  const field = () => props.field ?? <NumberField {...fieldProps(props)} />;
  return (
    <Show when={props.ends} fallback={<Stacked {...props} id={id} track={track()} field={field()} />}>
      {(ends) => (
        <div class="control between" title={props.words}>
          <label for={id} class="unseen">
            {props.label}
          </label>
          <span>{ends()[0]}</span>
          {track()}
          <span>{ends()[1]}</span>
          {field()}
        </div>
      )}
    </Show>
  );
}

/** Label and field above the slider, ticks below. */
function Stacked(props: Omit<SliderProps, "field"> & { readonly id: string; readonly track: JSX.Element; readonly field: JSX.Element }) {
  return (
    <div class="control" classList={{ disabled: props.disabled ?? false }}>
      <div class="control-head">
        <label for={props.id}>{props.label}</label>
        <span class="note">{props.note}</span>
        {props.field}
      </div>
      {props.plot}
      {props.track}
      <Show when={props.ticks}>{(ticks) => <Ticks ticks={ticks()} />}</Show>
    </div>
  );
}

function fieldProps(props: SliderProps) {
  return {
    label: props.label,
    get value() {
      return props.value;
    },
    get disabled() {
      return props.disabled ?? false;
    },
    get step() {
      return props.step ?? 1;
    },
    get min() {
      return props.min;
    },
    get max() {
      return props.max;
    },
    get isWhole() {
      return props.isWhole;
    },
    get hundredPercent() {
      return props.hundredPercent;
    },
    get units() {
      return props.units;
    },
    onChange: (value: number) => props.onChange(value),
  };
}

function Ticks(props: { readonly ticks: readonly { readonly at: number; readonly text: string }[] }) {
  return (
    <div class="ticks" aria-hidden="true">
      <For each={props.ticks}>{(tick) => <span style={{ "--at": String(tick.at) }}>{tick.text}</span>}</For>
    </div>
  );
}
