/** Peeling: fine parts of the surface are hidden, by a slider that can move by itself. */

import { createSignal, onCleanup } from "solid-js";
import { LEVELS } from "../../protocol/generated";
import { levelOf } from "../../state/look";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { Slider, type Scale } from "../widgets/slider";

const COARSEST = LEVELS - 1;
/** For a level, while the slider moves by itself. */
const LEVEL_MS = 900;
const GESTURE = "peel";

const SCALE: Scale = { toValue: (t) => levelOf(Math.round(t * COARSEST)), toPosition: (level) => level / COARSEST };
const TICKS = Array.from({ length: LEVELS }, (_, level) => ({ at: level / COARSEST, text: String(level) }));

/** What is shown from a level on. */
function peelText(level: number): string {
  return level === 0 ? "everything" : `parts of ${2 ** level} cells and more`;
}

/** The level after this one, while there is a coarser one that has triangles. */
export function nextLevel(level: number, triangles: readonly number[]): number | undefined {
  return level < triangles.findLastIndex((n) => n > 0) ? level + 1 : undefined;
}

export function Peel() {
  const { actions, facts, look } = useModel();
  const [timer, setTimer] = createSignal<ReturnType<typeof setInterval>>();
  const level = () => look().finestLevel;
  const show = (finestLevel: number, gesture: string) => actions.changeLook({ finestLevel }, gesture);
  const stop = () => {
    clearInterval(timer());
    setTimer(undefined);
    actions.endGesture();
  };
  const advance = () => {
    const next = nextLevel(level(), facts().levelTriangles);
    if (next === undefined) stop();
    else show(next, GESTURE);
  };
  const play = () => {
    if (nextLevel(level(), facts().levelTriangles) === undefined) show(0, GESTURE);
    setTimer(setInterval(advance, LEVEL_MS));
  };
  onCleanup(() => {
    if (timer() !== undefined) stop();
  });
  return (
    <Slider
      label="Peel"
      note={peelText(level())}
      value={level()}
      scale={SCALE}
      steps={COARSEST}
      ticks={TICKS}
      words={`Level ${level()}: ${peelText(level())}`}
      field={
        <Button quiet label={timer() === undefined ? "Play peeling" : "Stop peeling"} onClick={() => (timer() === undefined ? play() : stop())}>
          {timer() === undefined ? "Play" : "Stop"}
        </Button>
      }
      onChange={(to) => {
        if (timer() !== undefined) stop();
        show(to, GESTURE);
      }}
      onEnd={actions.endGesture}
    />
  );
}
