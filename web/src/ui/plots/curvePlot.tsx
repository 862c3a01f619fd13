/** The estimated error against triangles, over the slider of detail and on its axis. */

import { createMemo, createUniqueId, Show } from "solid-js";
import type { Curve } from "../../protocol/types";
import type { LengthScale } from "../../state/lengths";
import { formatCount, formatLength, formatShare } from "../format";
import { errorAt, FINE_ERROR, fineSide, linePath, meetsAxisText, nowFits, toX, toY, trianglesFor } from "./errorCurve";

const SIZE = { width: 296, height: 46 };
/** Height of a line of text. */
const TEXT_HEIGHT = 10;
/** Lines of equal error, in voxels. */
const GRID = [0.01, 0.1, 1];
export interface CurvePlotProps {
  readonly points: Curve["points"];
  /** Triangles of the full surface. */
  readonly full: number;
  readonly lengths: LengthScale;
  /** Position of the slider. */
  readonly share: number;
  /** Triangles above which none are made, whatever the share. */
  readonly maximum: number | undefined;
}

export function CurvePlot(props: CurvePlotProps) {
  const line = createMemo(() => linePath(props.points, props.full, props.lengths.spacing, SIZE));
  const fewest = () => props.points.at(-1)?.triangles ?? 0;
  const left = () => toX(fewest() / props.full, SIZE);
  const right = () => toX(Math.min(1, (props.maximum ?? Infinity) / props.full), SIZE);
  const now = () => errorAt(props.points, props.share * props.full);
  const nowX = () => toX(props.share, SIZE);
  const nowText = () => (now() === undefined ? "" : `≈ ${formatLength(now() ?? 0, props.lengths)}`);
  const voxels = (count: number) => formatLength(count * props.lengths.spacing, props.lengths);
  return (
    <svg class="curve-plot" viewBox={`0 0 ${SIZE.width} ${SIZE.height}`} role="img" aria-label={curveWords(props)}>
      <rect class="frame" x={0.5} y={0.5} width={SIZE.width - 1} height={SIZE.height - 1} rx={4} />
      {GRID.map((error) => (
        <line class="grid" x1={1} x2={SIZE.width - 1} y1={toY(error, SIZE)} y2={toY(error, SIZE)} />
      ))}
      <Unreachable from={0} to={left()} why={`The coarsest surface that keeps to importance and guards has ${formatCount(fewest())} triangles`} />
      <Unreachable from={right()} to={SIZE.width} why={`At most ${formatCount(props.maximum ?? 0)} triangles are made`} />
      <path class="error-area" d={`${line()}L${SIZE.width} ${SIZE.height}L${left()} ${SIZE.height}Z`} />
      <path class="error-line" d={line()} />
      <Show when={trianglesFor(props.points, FINE_ERROR * props.lengths.spacing)}>{(triangles) => <FineMark x={toX(triangles() / props.full, SIZE)} besides={nowX()} text={voxels(FINE_ERROR)} />}</Show>
      <Show when={!meetsAxisText(voxels(1), nowText(), nowX(), (now() ?? 0) / props.lengths.spacing, SIZE)}>
        <text class="axis-text" x={SIZE.width - 5} y={toY(1, SIZE) - 3} text-anchor="end">
          {voxels(1)}
        </text>
      </Show>
      <Show when={now()}>
        {(rms) => (
          <g transform={`translate(${nowX()} ${toY(rms() / props.lengths.spacing, SIZE)})`}>
            <line class="drop" y2={SIZE.height - toY(rms() / props.lengths.spacing, SIZE)} />
            <circle class="now" r={4.5} />
            <NowText text={nowText()} x={nowX()} y={toY(rms() / props.lengths.spacing, SIZE)} />
          </g>
        )}
      </Show>
    </svg>
  );
}

/** The error at the point: above the falling curve, to its right, but not out of the plot. */
function NowText(props: { readonly text: string; readonly x: number; readonly y: number }) {
  const fits = () => nowFits(props.text, props.x, SIZE);
  return (
    <text class="now-text" x={fits() ? 6 : SIZE.width - props.x - 2} y={Math.max(-7, TEXT_HEIGHT - props.y)} text-anchor={fits() ? "start" : "end"}>
      {props.text}
    </text>
  );
}

function Unreachable(props: { readonly from: number; readonly to: number; readonly why: string }) {
  const pattern = createUniqueId();
  return (
    <Show when={props.to - props.from > 1}>
      <pattern id={pattern} width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">
        <line class="hatch" x1="0" y1="0" x2="0" y2="6" />
      </pattern>
      <rect class="unreachable" fill={`url(#${pattern})`} x={props.from} width={props.to - props.from} y={1} height={SIZE.height - 2}>
        <title>{props.why}</title>
      </rect>
    </Show>
  );
}

/** Mark at which the error reaches a tenth of a voxel. `besides`: position of a line down from the curve, which the text must not cover. */
function FineMark(props: { readonly x: number; readonly besides: number; readonly text: string }) {
  const side = () => fineSide(props.text, props.x, props.besides, SIZE);
  return (
    <g class="fine-mark">
      <line x1={props.x} x2={props.x} y1={toY(FINE_ERROR, SIZE)} y2={SIZE.height - 1} />
      <Show when={side()}>
        {(anchor) => (
          <text x={props.x + (anchor() === "start" ? 4 : -4)} y={SIZE.height - 4} text-anchor={anchor()}>
            {props.text}
          </text>
        )}
      </Show>
    </g>
  );
}

/** The curve in a sentence. */
export function curveWords({ points, full, lengths }: CurvePlotProps): string {
  const [finest, coarsest] = [points[0], points.at(-1)];
  if (finest === undefined || coarsest === undefined) return "Estimated error against triangles";
  const fine = trianglesFor(points, FINE_ERROR * lengths.spacing);
  const range = `Estimated error against triangles: ${formatLength(coarsest.rms, lengths)} with ${formatCount(coarsest.triangles)}, ${finest.rms > 0 ? formatLength(finest.rms, lengths) : "none"} with ${formatCount(full)}`;
  return fine === undefined ? range : `${range}; ${formatLength(FINE_ERROR * lengths.spacing, lengths)} with ${formatShare(fine / full)} of them`;
}
