/** Curves over time: area, volume and values at points, measured in every step. Loaded when there are time steps. */

import { createMemo, For, Show } from "solid-js";
import { volumeName } from "../../state/fileNames";
import { curvesOf, placesOfSteps, timeCurvesCsv, type Curve } from "../../state/timeCurves";
import { stepCount, stepLabel } from "../../state/timeSteps";
import { formatValue } from "../format";
import { useModel } from "../model";
import { saveFile } from "../takeAlong";
import { Button } from "../widgets/button";
import "../style/timeCurves.css";

export default function TimeCurvesRows() {
  const { actions, curves, look, viewer, volume } = useModel();
  const known = createMemo(() => (curves()?.volume === volume()?.id ? curves() : undefined));
  const lines = createMemo(() => {
    const of = known();
    return of === undefined ? [] : curvesOf(of, volume());
  });
  const hasPoints = () => look().measures.some(({ kind }) => kind === "reading");
  const isOpen = () => known()?.rows.every(({ sums }) => sums === undefined || sums.volume === undefined) ?? false;
  const save = () => {
    const [of, file] = [known(), volume()];
    if (of !== undefined && file !== undefined) saveFile(`${volumeName(file)}-over-time.csv`, new Blob([timeCurvesCsv(of, file, (step) => stepLabel(viewer(), step))], { type: "text/csv" }));
  };
  return (
    <>
      <div class="control row">
        <span class="label">Area, volume</span>
        <Show when={known()?.isRunning} fallback={<Button onClick={() => actions.measureOverTime(true)}>Measure {stepCount(viewer())} steps</Button>}>
          <span class="inline">
            <span role="status">
              {known()?.rows.length} of {known()?.count}
            </span>
            <Button onClick={() => actions.measureOverTime(false)}>Stop</Button>
          </span>
        </Show>
      </div>
      <Show when={known() === undefined && !hasPoints()}>
        <p class="note">For the value at a point too, click one with Values in the card Measure</p>
      </Show>
      <For each={lines()}>{(curve) => <Plot curve={curve} />}</For>
      <Show when={lines().length > 0 && known()?.isRunning === false}>
        <div class="control row">
          <span class="note">{isOpen() ? "Of the triangles on screen. The surface is open: no volume" : "Of the triangles on screen"}</span>
          <Button label="Save CSV of the curves over time" onClick={save}>
            Save CSV
          </Button>
        </div>
      </Show>
    </>
  );
}

const WIDTH = 312;
const HEIGHT = 84;
const LEFT = 52;
const BOTTOM = 17;
const TOP = 6;
const PLOT = { width: WIDTH - LEFT - 8, height: HEIGHT - BOTTOM - TOP };

/** Dates without the time of day: the axis is short. */
const shortLabel = (label: string) => label.replace(/[ T]\d\d:\d\d.*$/, "");

function Plot(props: { readonly curve: Curve }) {
  const { actions, curves, step, viewer, volume } = useModel();
  const places = createMemo(() => {
    const of = curves();
    return of === undefined ? [] : placesOfSteps(of, volume()?.times);
  });
  const bounds = createMemo(() => {
    const found = props.curve.values.filter((value) => value !== undefined);
    const [low, high] = [Math.min(...found), Math.max(...found)];
    return low < high ? [low, high] as const : [low - 1, high + 1] as const;
  });
  const x = (i: number) => PLOT.width * (places()[i] ?? 0);
  const y = (value: number) => PLOT.height * (1 - (value - bounds()[0]) / (bounds()[1] - bounds()[0]));
  const path = () => {
    let pen = "M";
    return props.curve.values
      .map((value, i) => {
        const part = value === undefined ? "" : `${pen}${x(i).toFixed(1)} ${y(value).toFixed(1)}`;
        pen = value === undefined ? "M" : "L";
        return part;
      })
      .join("");
  };
  const label = (at: number) => shortLabel(stepLabel(viewer(), at) ?? `step ${at + 1}`);
  const count = () => curves()?.count ?? 1;
  const now = () => props.curve.values[step()];
  /** To the step that is nearest to the pointer. */
  const go = (event: MouseEvent & { readonly currentTarget: SVGSVGElement }) => {
    const { left, width } = event.currentTarget.getBoundingClientRect();
    const at = (((event.clientX - left) / width) * WIDTH - LEFT) / PLOT.width;
    const nearest = places().reduce((best, place, i) => (Math.abs(place - at) < Math.abs((places()[best] ?? 9) - at) ? i : best), 0);
    if (curves()?.isRunning !== true) actions.goToStep(nearest);
  };
  return (
    <figure class="time-curve">
      <figcaption>
        <span>{props.curve.title}</span>
        <span class="note">{now() === undefined ? "" : formatValue(now() ?? 0)}</span>
      </figcaption>
      <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={curveWords(props.curve, label, bounds())} on:click={go}>
        <g transform={`translate(${LEFT} ${TOP})`}>
          <Ends bounds={bounds()} texts={[label(0), label(count() - 1)]} />
          <Show when={step() < props.curve.values.length}>
            <line class="now" x1={x(step())} x2={x(step())} y1={0} y2={PLOT.height} />
          </Show>
          <path d={path()} />
          <For each={props.curve.values}>{(value, i) => <Show when={value !== undefined}>{<circle cx={x(i())} cy={y(value ?? 0)} r={2} />}</Show>}</For>
        </g>
      </svg>
    </figure>
  );
}

/** What the ends of both axes are. */
function Ends(props: { readonly bounds: readonly [number, number]; readonly texts: readonly [string, string] }) {
  return (
    <>
      <For each={props.bounds}>
        {(value, i) => (
          <>
            <line class="grid" x1={0} x2={PLOT.width} y1={PLOT.height * (1 - i())} y2={PLOT.height * (1 - i())} />
            <text x={-6} y={PLOT.height * (1 - i()) + 3.5} text-anchor="end">
              {formatValue(value, 4)}
            </text>
          </>
        )}
      </For>
      <text x={0} y={PLOT.height + BOTTOM - 3}>
        {props.texts[0]}
      </text>
      <text x={PLOT.width} y={PLOT.height + BOTTOM - 3} text-anchor="end">
        {props.texts[1]}
      </text>
    </>
  );
}

/** For those who do not see the curve. */
function curveWords({ title, values }: Curve, label: (step: number) => string, [low, high]: readonly [number, number]): string {
  const at = (value: number) => label(Math.max(0, values.indexOf(value)));
  return `${title}: from ${formatValue(low)} (${at(low)}) to ${formatValue(high)} (${at(high)}) over ${values.length} steps`;
}
