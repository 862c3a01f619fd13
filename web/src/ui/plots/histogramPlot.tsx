/** A histogram with axes, as large as its card. */

import { createMemo, createSignal, For, Show } from "solid-js";
import type { Histogram } from "../../protocol/types";
import { ticks, tickText } from "../../world/ticks";
import { digitsBetween, formatCount, formatShare, formatValue } from "../format";
import { binAt, countTicks, heightOf, shortCount, stepPath, type CountScale } from "./axis";

const WIDTH = 312;
const HEIGHT = 118;
/** Space for the numbers beside and below. */
const LEFT = 38;
const BOTTOM = 18;
const TOP = 6;
const PLOT = { width: WIDTH - LEFT - 6, height: HEIGHT - BOTTOM - TOP };
const MAX_TICKS = 5;

/** An isovalue on it. */
export interface ValueMark {
  readonly value: number;
  /** `#rrggbb`; without it the colour of texts. */
  readonly color: string | undefined;
}

export function HistogramPlot(props: { readonly histogram: Histogram; readonly scale: CountScale; readonly unit: string | undefined; readonly marks: readonly ValueMark[] }) {
  const [share, setShare] = createSignal<number>();
  const peak = () => Math.max(0, ...props.histogram.counts);
  const path = createMemo(() => stepPath(props.histogram, props.scale, PLOT.width, PLOT.height));
  const span = () => props.histogram.max - props.histogram.min || 1;
  const x = (value: number) => (PLOT.width * (value - props.histogram.min)) / span();
  const y = (count: number) => PLOT.height * (1 - heightOf(count, peak(), props.scale));
  const values = () => ticks(props.histogram.min, props.histogram.max, MAX_TICKS);
  const step = () => (values()[1] ?? 1) - (values()[0] ?? 0);
  const found = () => {
    const at = share();
    return at === undefined ? undefined : binAt(props.histogram, at);
  };
  const move = (event: PointerEvent & { readonly currentTarget: SVGSVGElement }) => {
    const { left, width } = event.currentTarget.getBoundingClientRect();
    const at = (((event.clientX - left) / width) * WIDTH - LEFT) / PLOT.width;
    setShare(at >= 0 && at <= 1 ? at : undefined);
  };
  return (
    <>
      <svg class="histogram-plot" viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={plotWords(props.histogram, props.unit)} on:pointermove={move} on:pointerleave={() => setShare(undefined)}>
        <g transform={`translate(${LEFT} ${TOP})`}>
          <For each={countTicks(peak(), props.scale)}>
            {(count) => (
              <>
                <line class="grid" x1={0} x2={PLOT.width} y1={y(count)} y2={y(count)} />
                <text x={-6} y={y(count) + 3.5} text-anchor="end">
                  {shortCount(count)}
                </text>
              </>
            )}
          </For>
          <path class="histogram" d={path()} />
          <Show when={found()}>{(bin) => <rect class="bin" x={x(bin().low)} width={PLOT.width / props.histogram.counts.length} y={0} height={PLOT.height} />}</Show>
          <For each={props.marks}>{(mark) => <line class="mark" x1={x(mark.value)} x2={x(mark.value)} y1={-TOP} y2={PLOT.height} style={{ stroke: mark.color ?? "var(--text)" }} />}</For>
          <line class="axis" x1={0} x2={PLOT.width} y1={PLOT.height} y2={PLOT.height} />
          <For each={values()}>
            {(value) => (
              <>
                <line class="axis" x1={x(value)} x2={x(value)} y1={PLOT.height} y2={PLOT.height + 4} />
                <text x={Math.min(x(value), PLOT.width - 4)} y={PLOT.height + 14} text-anchor="middle">
                  {tickText(value, step())}
                </text>
              </>
            )}
          </For>
        </g>
      </svg>
      <p class="note bin-words">{binWords(props.histogram, found(), props.unit)}</p>
    </>
  );
}

/** What a bin holds; without one how wide bins are. */
function binWords(histogram: Histogram, bin: ReturnType<typeof binAt> | undefined, unit: string | undefined): string {
  const behind = unit === undefined ? "" : ` ${unit}`;
  const width = (histogram.max - histogram.min) / histogram.counts.length;
  if (bin === undefined) return width > 0 ? `${histogram.counts.length} bins of ${formatValue(width, 3)}${behind}` : "All values are equal";
  const digits = digitsBetween(histogram.min, histogram.max);
  const all = histogram.counts.reduce((sum, n) => sum + n, 0);
  return `${formatValue(bin.low, digits)} to ${formatValue(bin.high, digits)}${behind}: ${formatCount(bin.count)} samples (${formatShare(bin.count / Math.max(1, all))})`;
}

/** For readers of the screen. */
function plotWords(histogram: Histogram, unit: string | undefined): string {
  const peak = Math.max(0, ...histogram.counts);
  const at = binAt(histogram, (histogram.counts.indexOf(peak) + 0.5) / histogram.counts.length);
  const behind = unit === undefined ? "" : ` ${unit}`;
  return `Histogram from ${formatValue(histogram.min)} to ${formatValue(histogram.max)}${behind}, with most samples around ${formatValue((at.low + at.high) / 2, 3)}${behind}`;
}
