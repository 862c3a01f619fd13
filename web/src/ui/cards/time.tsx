/** Which time step of the volume is shown, and a player through all of them. */

import { createUniqueId, lazy, Show, Suspense } from "solid-js";
import type { Card } from "./card";
import { useModel } from "../model";
import { IconButton } from "../widgets/button";
import { Select } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { nextStep, stepCount, stepLabel, stepWords } from "../../state/timeSteps";

const TimeCurves = lazy(() => import("./timeCurves"));

/** Steps in a second. */
const SPEEDS = [0.5, 1, 2, 5, 10, 25] as const;

function Body() {
  return (
    <>
      <Steps />
      <Suspense>
        <TimeCurves />
      </Suspense>
    </>
  );
}

function Steps() {
  const { actions, viewer, page, step } = useModel();
  const id = createUniqueId();
  const count = () => stepCount(viewer());
  const player = () => page().player;
  const change = (changed: Partial<ReturnType<typeof player>>) => actions.changePage({ player: { ...player(), ...changed } });
  const go = (to: number, gesture?: string) => actions.goToStep(Math.min(count() - 1, Math.max(0, Math.round(to))), gesture);
  // By hand it is the user who moves.
  const goByHand = (to: number) => {
    change({ playing: false });
    go(to);
  };
  const atEnd = () => nextStep(step(), count(), false) === undefined;
  const play = () => {
    if (!player().playing && atEnd() && !player().loop) go(0);
    change({ playing: !player().playing });
  };
  return (
    <>
      <div class="control">
        <div class="control-head">
          <label for={id}>Time step</label>
          <span class="note" />
          <NumberField label="Number of the time step, from 1" value={step() + 1} min={1} max={count()} isWhole onChange={(value) => goByHand(value - 1)} />
          <span>of {count()}</span>
        </div>
        <input
          id={id}
          type="range"
          min={0}
          max={count() - 1}
          step={1}
          aria-valuetext={stepWords(viewer(), step())}
          style={{ "--fill": `${(step() / Math.max(1, count() - 1)) * 100}%` }}
          value={String(step())}
          on:input={(event) => {
            change({ playing: false });
            go(Number(event.currentTarget.value), "time");
          }}
          on:change={() => actions.endGesture()}
        />
        <Show when={stepLabel(viewer(), step())}>{(label) => <p class="note step-label">{label()}</p>}</Show>
      </div>
      <div class="control row player">
        <IconButton icon="previous" label="Previous time step" keys="," disabled={step() === 0} onClick={() => goByHand(step() - 1)} />
        <IconButton icon={player().playing ? "pause" : "play"} label={player().playing ? "Pause" : "Play"} keys="P" onClick={play} />
        <IconButton icon="next" label="Next time step" keys="." disabled={atEnd()} onClick={() => goByHand(step() + 1)} />
        <IconButton icon="loop" label="Loop" pressed={player().loop} onClick={() => change({ loop: !player().loop })} />
        <Select
          label="Speed"
          hideLabel
          value={String(player().speed)}
          options={SPEEDS.map((speed) => ({ value: String(speed), text: `${speed} / s` }))}
          onChange={(speed) => change({ speed: Number(speed) })}
        />
      </div>
    </>
  );
}

export const timeCard: Card = { id: "time", title: "Time", icon: "time", when: ({ viewer }) => stepCount(viewer()) > 1, body: Body };
