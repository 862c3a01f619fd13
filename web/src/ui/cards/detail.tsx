/** How fine the surface is: one slider, and in words what limits it. */

import { createMemo, For, lazy, Show, Suspense } from "solid-js";
import type { Statistics, View } from "../../protocol/types";
import { cutsTree } from "../../protocol/view";
import { allTriangles } from "../../state/counts";
import { budgetEdit, sharedStatistics, sharerCount } from "../../state/sharedBudget";
import { formatCount, formatLength, formatShare } from "../format";
import { useModel, useScale } from "../model";
import { CurvePlot } from "../plots/curvePlot";
import { corrected, correctionOf, errorAt, NO_CORRECTION, type Correction } from "../plots/errorCurve";
import { Button } from "../widgets/button";
import { NumberField } from "../widgets/numberField";
import { Toggle } from "../widgets/choice";
import { Slider } from "../widgets/slider";
import type { Card } from "./card";
import { limitsOf, pixelLimit, type Limit } from "./limits";
import { budgetOf, SHARE_SCALE, SHARE_TICKS, shareOf, trianglesShown } from "./share";

const Expert = lazy(() => import("./expert"));

function Body() {
  const { view } = useModel();
  return <Show when={view()}>{(known) => <Detail view={known()} />}</Show>;
}

function Detail(props: { readonly view: View }) {
  const { actions, viewer } = useModel();
  const scale = useScale();
  const spacing = () => scale().spacing;
  /** Of all surfaces that share the budget. */
  const statistics = () => sharedStatistics(viewer());
  const share = () => shareOf(props.view, statistics(), spacing()) ?? 1;
  const shown = () => trianglesShown(props.view, statistics(), spacing());
  /** Of the surface that was measured last, as long as none is. */
  const correction = createMemo<Correction>((before) => {
    const found = viewer().statistics;
    if (found === undefined) return NO_CORRECTION;
    const { error, estimatedError } = found;
    return error === null || estimatedError === null ? before : correctionOf(error.rms, estimatedError.rms);
  }, NO_CORRECTION);
  const curve = createMemo(() => {
    const points = viewer().answers.curve?.value.points;
    return points && corrected(points, correction());
  });
  /** Of the selected one: the curve is about it. */
  const full = () => viewer().statistics?.fullTriangles ?? 0;
  const maximum = () => {
    const [max, all] = [maximumOf(props.view), statistics()?.fullTriangles ?? 0];
    return max === undefined || all === 0 ? max : (max * full()) / all;
  };
  const expected = () => {
    const rms = errorAt(curve() ?? [], share() * full());
    return rms === undefined ? undefined : formatLength(rms, scale());
  };
  return (
    <>
      <Slider
        label="Triangles"
        note={`${formatShare(share())} of ${allWords(sharerCount(viewer()))}`}
        plot={
          <Show when={full() > 0 && curve()}>
            {(points) => <CurvePlot points={points()} full={full()} lengths={scale()} share={share()} maximum={maximum()} />}
          </Show>
        }
        value={share()}
        scale={SHARE_SCALE}
        ticks={SHARE_TICKS}
        words={shareWords(share(), shown(), statistics(), expected())}
        onChange={(value, gesture) => actions.edit({ triangles: budgetOf(value, props.view) }, gesture)}
        onEnd={actions.endGesture}
        field={<TrianglesField shown={shown()} full={statistics()?.fullTriangles} />}
      />
      <Limits view={props.view} />
      <Show when={cutsTree(props.view)}>
        <Finer detail={props.view.detail} />
      </Show>
      <details class="expert">
        <summary>Expert</summary>
        <Suspense>
          <Expert />
        </Suspense>
      </details>
    </>
  );
}

function TrianglesField(props: { readonly shown: number; readonly full: number | undefined }) {
  const { actions } = useModel();
  const step = () => Number((props.shown / 10 || 100).toPrecision(1));
  return (
    <NumberField
      label="Triangles"
      wide
      isWhole
      value={props.shown}
      min={1}
      step={step()}
      hundredPercent={props.full}
      units={{ triangles: 1 }}
      onChange={(n) => actions.edit({ triangles: Math.round(n) })}
    />
  );
}

/** The triangles above which the view makes none. */
function maximumOf({ triangles }: View): number | undefined {
  return typeof triangles === "object" ? triangles.max : undefined;
}

/** Words for all triangles of `surfaces` surfaces that share the budget. */
export function allWords(surfaces: number): string {
  if (surfaces < 2) return "all";
  return surfaces === 2 ? "both" : `all ${surfaces}`;
}

/** `19 percent, 87,501 of 454,932 triangles, error about 0.11 voxels`; `expected`: the error. */
export function shareWords(share: number, shown: number, statistics: Statistics | undefined, expected: string | undefined): string {
  if (statistics === undefined) return "not known yet";
  const triangles = `${formatShare(share).replace(" %", " percent")}, ${formatCount(shown)} of ${formatCount(allTriangles(statistics))} triangles`;
  return expected === undefined ? triangles : `${triangles}, error about ${expected}`;
}

function Limits(props: { readonly view: View }) {
  const { viewer } = useModel();
  const scale = useScale();
  const pixels = () => pixelLimit(props.view, viewer().statistics);
  const limits = () => limitsOf(props.view, sharedStatistics(viewer()), viewer().refusal, scale(), budgetEdit(viewer(), { share: 0.25 }), sharerCount(viewer()) < 2 ? viewer().answers.curve?.value : undefined);
  return (
    <ul class="limits">
      <Show when={pixels()}>{(limit) => <LimitItem limit={limit()} isSteady />}</Show>
      <For each={limits()}>{(limit) => <LimitItem limit={limit} />}</For>
    </ul>
  );
}

/** @param props.isSteady the text changes with the camera: the item keeps its height */
function LimitItem(props: { readonly limit: Limit; readonly isSteady?: boolean }) {
  const { actions } = useModel();
  return (
    <li classList={{ steady: props.isSteady ?? false }}>
      <span>{props.limit.text}</span>
      <Show when={props.limit.lift}>
        {(lift) => (
          <Button quiet onClick={() => actions.edit(lift().edit)}>
            {lift().text}
          </Button>
        )}
      </Show>
    </li>
  );
}

/** Whether the surface follows the camera. */
function Finer(props: { readonly detail: View["detail"] }) {
  const { actions } = useModel();
  return (
    <div class="control">
      <Toggle label="Finer where you look" on={props.detail === "view"} onChange={(on) => actions.edit({ detail: on ? "view" : "uniform" })} />
      <p class="note">Near parts get more triangles, far ones and those out of sight fewer. Exported files are uniform.</p>
    </div>
  );
}

export const detailCard: Card = { id: "detail", title: "Detail", icon: "detail", isOfSurface: true, needs: "edit", body: Body };
