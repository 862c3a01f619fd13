/** The transfer function as a plot: importance over the blended feature, with a handle for each control point. */

import { createMemo, createUniqueId, For, Index, Show } from "solid-js";
import type { Histogram } from "../../protocol/types";
import { formatColor, parseColor, type Points } from "../../transfer/model";
import { histogramPath } from "./histogram";

const WIDTH = 312;
const HEIGHT = 100;
/** Space for half a handle on every side. */
const PAD = 9;

const toX = (x: number) => PAD + x * (WIDTH - 2 * PAD);
const toY = (importance: number) => PAD + (1 - importance) * (HEIGHT - 2 * PAD);

/** A histogram behind the curve: the values that are 0 and 1 on the plot's axis. */
export interface Background {
  readonly histogram: Histogram;
  readonly range: readonly [number, number];
  /** The part of it that becomes coarse. */
  readonly coarse?: Histogram;
}

/** What was found on the surface: a place on the curve. */
export interface Mark {
  readonly x: number;
  readonly importance: number;
}

export interface TransferPlotProps {
  readonly points: Points;
  readonly selected: number;
  readonly background: Background | undefined;
  /** The importance up to which cubes are decimated, if importance decides. */
  readonly threshold: number | undefined;
  /** What lies under the pointer in the picture. */
  readonly mark: Mark | undefined;
  readonly onPointerDown: (event: PointerEvent & { readonly currentTarget: SVGSVGElement }) => void;
  readonly onPointerMove: (event: PointerEvent & { readonly currentTarget: SVGSVGElement }) => void;
  readonly onDrop: () => void;
  readonly onDoubleClick: (event: MouseEvent & { readonly currentTarget: SVGSVGElement }) => void;
  readonly onFocus: (index: number) => void;
  readonly onKey: (event: KeyboardEvent) => void;
  readonly ref: (element: SVGSVGElement) => void;
}

/** The control point whose handle an event hit. */
export function handleAt(event: Event): number | undefined {
  const handle = event.target instanceof Element ? event.target.closest("[data-index]") : null;
  return handle === null ? undefined : Number(handle.getAttribute("data-index"));
}

/** Position of the pointer on the plot, rounded to a thousandth. */
export function locate(plot: SVGSVGElement, event: MouseEvent): { readonly x: number; readonly importance: number } {
  const box = plot.getBoundingClientRect();
  const round = (value: number) => Math.round(Math.min(1, Math.max(0, value)) * 1000) / 1000;
  return {
    x: round((((event.clientX - box.left) / box.width) * WIDTH - PAD) / (WIDTH - 2 * PAD)),
    importance: round(1 - (((event.clientY - box.top) / box.height) * HEIGHT - PAD) / (HEIGHT - 2 * PAD)),
  };
}

function linePath(points: Points): string {
  const inner = points.map((p) => `L${toX(p.x)} ${toY(p.importance)}`).join("");
  return `M${toX(0)} ${toY(points[0]?.importance ?? 0)}${inner}L${toX(1)} ${toY(points.at(-1)?.importance ?? 0)}`;
}

export function TransferPlot(props: TransferPlotProps) {
  const gradient = createUniqueId();
  const line = createMemo(() => linePath(props.points));
  return (
    <svg
      ref={(element) => props.ref(element)}
      class="transfer-plot"
      viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
      role="group"
      aria-label="Transfer function: importance over the values of this surface. Double-click adds a point"
      on:pointerdown={(event) => props.onPointerDown(event)}
      on:pointermove={(event) => props.onPointerMove(event)}
      on:pointerup={() => props.onDrop()}
      on:pointercancel={() => props.onDrop()}
      on:dblclick={(event) => props.onDoubleClick(event)}
      on:focusin={(event) => props.onFocus(handleAt(event) ?? -1)}
      on:keydown={(event) => props.onKey(event)}
    >
      <linearGradient id={gradient} gradientUnits="userSpaceOnUse" x1={PAD} x2={WIDTH - PAD} y1={0} y2={0}>
        <For each={props.points}>{(p) => <stop offset={p.x} stop-color={formatColor(parseColor(p.color))} />}</For>
      </linearGradient>
      <rect class="frame" x={PAD} y={PAD} width={WIDTH - 2 * PAD} height={HEIGHT - 2 * PAD} rx={3} />
      <path class="curve" transform={`translate(${PAD} ${PAD})`} d={backgroundPath(props.background)} />
      <path class="importance-area" fill={`url(#${gradient})`} d={`${line()}L${toX(1)} ${toY(0)}L${toX(0)} ${toY(0)}Z`} />
      <Show when={props.background?.coarse}>{(coarse) => <Coarse path={backgroundPath(props.background, coarse())} />}</Show>
      <Show when={props.threshold !== undefined && props.threshold >= 0}>
        <Threshold at={props.threshold ?? 0} isHatched={props.background?.coarse === undefined} />
      </Show>
      <path class="importance-line" d={line()} />
      <Show when={props.mark}>
        {(mark) => (
          <g class="found" transform={`translate(${toX(mark().x)} 0)`}>
            <line y1={toY(1)} y2={toY(0)} />
            <circle cy={toY(mark().importance)} r={5} />
          </g>
        )}
      </Show>
      <Index each={props.points}>
        {(point, index) => (
          <g
            class="handle"
            classList={{ selected: index === props.selected }}
            data-index={index}
            tabindex={0}
            role="button"
            aria-label={`Point ${index + 1} of ${props.points.length}: at ${point().x.toFixed(2)}, importance ${point().importance.toFixed(2)}, colour ${point().color}`}
            transform={`translate(${toX(point().x)} ${toY(point().importance)})`}
          >
            <circle class="grip" r={13} />
            <circle class="ring" r={8.5} />
            <circle class="dot" r={6} fill={point().color} />
          </g>
        )}
      </Index>
    </svg>
  );
}

function backgroundPath(background: Background | undefined, part?: Histogram): string {
  if (background === undefined) return "";
  return histogramPath(background.histogram, ...background.range, WIDTH - 2 * PAD, HEIGHT - 2 * PAD, part);
}

function Hatch(props: { readonly id: string }) {
  return (
    <pattern id={props.id} width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">
      <line class="hatch" x1="0" y1="0" x2="0" y2="6" />
    </pattern>
  );
}

/** The part of the surface that becomes coarse, hatched. */
function Coarse(props: { readonly path: string }) {
  const pattern = createUniqueId();
  return (
    <>
      <Hatch id={pattern} />
      <path class="decimated" fill={`url(#${pattern})`} transform={`translate(${PAD} ${PAD})`} d={props.path} />
    </>
  );
}

/** The importance up to which cubes are decimated. If it is not known which part of the surface that is, the whole area is hatched. */
function Threshold(props: { readonly at: number; readonly isHatched: boolean }) {
  const y = () => toY(Math.min(1, Math.max(0, props.at)));
  const pattern = createUniqueId();
  return (
    <>
      <Show when={props.isHatched}>
        <Hatch id={pattern} />
        <rect class="decimated" fill={`url(#${pattern})`} x={PAD} width={WIDTH - 2 * PAD} y={y()} height={Math.max(0, HEIGHT - PAD - y())} />
      </Show>
      <line class="threshold" x1={PAD} x2={WIDTH - PAD} y1={y()} y2={y()} />
    </>
  );
}
