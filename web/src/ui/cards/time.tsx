/** Which time step of the volume is open. */

import type { Card } from "./card";
import { useModel } from "../model";
import { Slider } from "../widgets/slider";

function Body() {
  const { actions, viewer, volume } = useModel();
  const last = () => Math.max(1, (volume()?.steps ?? 1) - 1);
  const step = () => viewer().target?.step ?? 0;
  const scale = { toValue: (t: number) => Math.round(t * last()), toPosition: (value: number) => value / last() };
  return (
    <Slider
      label="Time step"
      value={step()}
      scale={scale}
      min={0}
      max={last()}
      step={1}
      words={`step ${step() + 1} of ${last() + 1}`}
      onChange={(value) => actions.openStep(Math.min(last(), Math.max(0, Math.round(value))))}
      onEnd={() => undefined}
    />
  );
}

export const timeCard: Card = { id: "time", title: "Time", icon: "time", when: ({ volume }) => (volume()?.steps ?? 1) > 1, body: Body };
