/** The error up to which parts are merged, and its unit. */

import type { Statistics, View } from "../../protocol/types";
import { unitWord } from "../../state/lengths";
import { formatValue } from "../format";
import { useModel, useScale } from "../model";
import { Choice } from "../widgets/choice";
import { NumberField } from "../widgets/numberField";
import { Slider } from "../widgets/slider";
import { convertedError, errorInUnit, errorLimit, errorMeaning, errorScale, errorWordsOf, typedError, type ErrorInUnit, type ErrorUnit } from "./errorUnits";
import { formatPixels } from "./limits";

interface ErrorProps {
  readonly error: number | string;
  readonly view: View;
  readonly statistics: Statistics | undefined;
  /** A budget decides, which needs a greater error. */
  readonly isExceeded: boolean;
}

export function ErrorRows(props: ErrorProps) {
  const { actions } = useModel();
  const scale = useScale();
  const error = () => errorInUnit(props.error);
  const change = (error: ErrorInUnit, gesture?: string) => actions.edit({ error: errorLimit(error), triangles: props.view.triangles, bytes: props.view.bytes }, gesture);
  return (
    <>
      <Slider
        label="Error"
        value={error().value}
        scale={errorScale(error().unit, scale().spacing)}
        note={noteOf(error().unit, props, unitWord(scale().unit), scale().spacing)}
        words={errorMeaning(error(), unitWord(scale().unit))}
        onChange={(value, gesture) => change({ value, unit: error().unit }, gesture)}
        onEnd={actions.endGesture}
        field={<ErrorField error={error()} onChange={change} />}
      />
      <div class="control row">
        <span class="label">Error in</span>
        <Choice<ErrorUnit>
          label="Error in"
          value={error().unit}
          options={[
            { value: "px", text: "Pixels", hint: "Pixels of the picture: finer near the camera" },
            { value: "vx", text: "Voxels", hint: "Multiples of the smallest distance between samples" },
            { value: "world", text: scale().unit ?? "World", hint: unitWord(scale().unit) },
          ]}
          onChange={(unit) => change(convertedError(props.error, unit, scale().spacing))}
        />
      </div>
    </>
  );
}

/** A number that is typed with another unit changes the unit. */
function ErrorField(props: { readonly error: ErrorInUnit; readonly onChange: (error: ErrorInUnit) => void }) {
  const scale = useScale();
  const accept = (text: string) => {
    const typed = typedError(text, scale().unit);
    if (typed === undefined || typed.unit === props.error.unit) return false;
    props.onChange(typed);
    return true;
  };
  return (
    <NumberField
      label="Error"
      value={props.error.value}
      min={0}
      max={1000}
      step={Math.max(1e-3, Number((props.error.value / 10).toPrecision(1)))}
      units={errorWordsOf(scale().unit)}
      acceptText={accept}
      onChange={(value) => props.onChange({ value, unit: props.error.unit })}
    />
  );
}

/** The unit, and the error that is in force if that is another one. */
function noteOf(unit: ErrorUnit, { statistics, isExceeded }: ErrorProps, length: string, spacing: number): string {
  const tolerance = statistics?.tolerance ?? 0;
  if (unit === "px") return isExceeded && statistics?.pixels ? `pixels, now ${formatPixels(statistics.pixels.within)}` : "pixels";
  const word = unit === "vx" ? "× spacing" : length;
  return isExceeded ? `${word}, applied ${formatValue(unit === "vx" ? tolerance / spacing : tolerance, 2)}` : word;
}
