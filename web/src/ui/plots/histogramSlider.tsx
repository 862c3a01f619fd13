/** A histogram with a line for each surface that can be dragged: sliders in data units. */

import { createMemo, createUniqueId, Index } from "solid-js";
import type { Histogram } from "../../protocol/types";
import { formatValue } from "../format";
import { inkOn } from "../surfaceNames";
import { histogramPath } from "./histogram";

const WIDTH = 312;
const HEIGHT = 56;

/** One value on the histogram. */
export interface IsoHandle {
  /** Of its surface. */
  readonly number: number;
  readonly label: string;
  readonly value: number;
  /** Text in its knob; empty if there is only one handle. */
  readonly mark: string;
  /** `#rrggbb` of its surface, if it has one. */
  readonly color: string | undefined;
}

export interface HistogramSliderProps {
  readonly histogram: Histogram;
  readonly handles: readonly IsoHandle[];
  /** Number of the one that is changed; a handle that is taken becomes it. */
  readonly selected: number;
  readonly unit: string | undefined;
  readonly onSelect: (number: number) => void;
  readonly onChange: (value: number) => void;
  /** The drag, or what the keys did, is over. */
  readonly onEnd: () => void;
}

/** Distance in pixels within which a pointer grabs a handle. */
const GRAB = 12;

/** Ends of the slider; a histogram of one value has some width too. */
function ends({ min, max }: Histogram): readonly [number, number] {
  return [min, max > min ? max : min + 1];
}

/** The value to choose for a place in the range: four of its digits are finer than the slider, and stay readable. */
function roundedTo([low, high]: readonly [number, number], value: number): number {
  const bounded = Math.min(high, Math.max(low, value));
  const unit = 10 ** (Math.floor(Math.log10(high - low)) - 4);
  return unit >= 1 ? Math.round(bounded / unit) * unit : Number((Math.round(bounded / unit) * unit).toPrecision(12));
}

/** The value to which a key moves the slider. */
function keyed(key: string, shift: boolean, value: number, [low, high]: readonly [number, number]): number | undefined {
  const step = ((high - low) / 256) * (shift ? 10 : 1);
  const next: Partial<Record<string, number>> = {
    ArrowLeft: value - step,
    ArrowDown: value - step,
    ArrowRight: value + step,
    ArrowUp: value + step,
    PageDown: value - 16 * step,
    PageUp: value + 16 * step,
    Home: low,
    End: high,
  };
  return next[key];
}

/** Position of a value on the axis, 0 to 1. */
function placeOn([low, high]: readonly [number, number], value: number): number {
  return Math.min(1, Math.max(0, (value - low) / (high - low)));
}

/** Of the handles within reach the nearest, the selected one before others. */
function grabbed({ handles, selected }: HistogramSliderProps, range: readonly [number, number], x: number, width: number): IsoHandle | undefined {
  const near = handles.map((handle) => ({ handle, apart: Math.abs(placeOn(range, handle.value) * width - x) - (handle.number === selected ? 1 : 0) }));
  return near.filter(({ apart }) => apart <= GRAB).sort((a, b) => a.apart - b.apart)[0]?.handle;
}

export function HistogramSlider(props: HistogramSliderProps) {
  const clip = createUniqueId();
  let plot: SVGSVGElement | undefined;
  const range = () => ends(props.histogram);
  const path = createMemo(() => histogramPath(props.histogram, ...range(), WIDTH, HEIGHT));
  const chosen = () => props.handles.find(({ number }) => number === props.selected);
  const change = (value: number) => {
    const rounded = roundedTo(range(), value);
    if (rounded !== chosen()?.value) props.onChange(rounded);
  };
  const move = (event: PointerEvent & { readonly currentTarget: SVGSVGElement }) => {
    const box = event.currentTarget.getBoundingClientRect();
    const [low, high] = range();
    change(low + ((high - low) * (event.clientX - box.left)) / box.width);
  };
  const down = (event: PointerEvent & { readonly currentTarget: SVGSVGElement }) => {
    if (event.button !== 0) return;
    event.preventDefault();
    event.currentTarget.setPointerCapture(event.pointerId);
    const box = event.currentTarget.getBoundingClientRect();
    const handle = grabbed(props, range(), event.clientX - box.left, box.width);
    if (handle === undefined || handle.number === props.selected) move(event);
    else props.onSelect(handle.number);
    plot?.querySelector<SVGElement>(`[data-number="${props.selected}"]`)?.focus({ preventScroll: true });
  };
  const onKey = (event: KeyboardEvent, handle: IsoHandle) => {
    const value = keyed(event.key, event.shiftKey, handle.value, range());
    if (value === undefined) return;
    event.preventDefault();
    if (handle.number !== props.selected) props.onSelect(handle.number);
    change(value);
  };
  return (
    <svg
      ref={(element) => (plot = element)}
      class="histogram-slider"
      classList={{ several: props.handles.length > 1 }}
      viewBox={`0 0 ${WIDTH} ${HEIGHT + (props.handles.length > 1 ? 10 : 6)}`}
      role="group"
      aria-label="Histogram of the field"
      on:pointerdown={down}
      on:pointermove={(event) => {
        if (event.currentTarget.hasPointerCapture(event.pointerId)) move(event);
      }}
      on:pointerup={() => props.onEnd()}
      on:pointercancel={() => props.onEnd()}
    >
      <clipPath id={clip}>
        <rect x={placeOn(range(), chosen()?.value ?? 0) * WIDTH} y={0} width={WIDTH} height={HEIGHT} />
      </clipPath>
      <path class="histogram" d={path()} />
      <path class="histogram above" d={path()} clip-path={`url(#${clip})`} />
      <line class="axis" x1={0} x2={WIDTH} y1={HEIGHT} y2={HEIGHT} />
      <Index each={props.handles}>
        {(handle) => <Needle handle={handle()} x={placeOn(range(), handle().value) * WIDTH} range={range()} unit={props.unit} isSelected={handle().number === props.selected} onKey={onKey} onEnd={() => props.onEnd()} />}
      </Index>
    </svg>
  );
}

function Needle(props: {
  readonly handle: IsoHandle;
  readonly x: number;
  readonly range: readonly [number, number];
  readonly unit: string | undefined;
  readonly isSelected: boolean;
  readonly onKey: (event: KeyboardEvent, handle: IsoHandle) => void;
  readonly onEnd: () => void;
}) {
  const color = () => props.handle.color;
  const style = () => (color() === undefined ? {} : { "--own": color(), "--ink": inkOn(color() ?? "") });
  return (
    <g
      class="needle"
      classList={{ selected: props.isSelected }}
      style={style()}
      transform={`translate(${props.x.toFixed(2)} 0)`}
      data-number={props.handle.number}
      tabindex={0}
      role="slider"
      aria-label={props.handle.label}
      aria-valuemin={props.range[0]}
      aria-valuemax={props.range[1]}
      aria-valuenow={props.handle.value}
      aria-valuetext={`${formatValue(props.handle.value)}${props.unit === undefined ? "" : ` ${props.unit}`}`}
      on:blur={() => props.onEnd()}
      on:keydown={(event) => props.onKey(event, props.handle)}
    >
      <rect class="needle-grip" x={-GRAB} width={2 * GRAB} y={0} height={HEIGHT + 6} />
      <line y1={0} y2={HEIGHT} />
      <circle class="needle-knob" cy={HEIGHT} r={props.handle.mark === "" ? 5 : 8.5} />
      <text class="needle-mark" y={HEIGHT + 3.6}>
        {props.handle.mark}
      </text>
    </g>
  );
}
