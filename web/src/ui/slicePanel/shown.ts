/** Which field slices show, and which of its values are black and white. */

import { createMemo } from "solid-js";
import { usualWindow } from "../../state/bounds";
import { useModel } from "../model";

/** Values that are black and white in the slices. */
export function useWindow(): () => readonly [number, number] {
  const { beside, look, volume } = useModel();
  const field = useShownField();
  return createMemo(() => {
    const [known, name] = [volume(), field()];
    const chosen = look().slices.window;
    if (chosen !== undefined) return chosen;
    if (known?.fields.some((one) => one.name === name) === true) return usualWindow(known, name);
    // Of an expression nothing is known here but what is shown.
    return rangeOf(beside.slices.flatMap(({ loaded }) => loaded?.planes.get(name)?.samples ?? []));
  });
}

/** Minimum and maximum of the samples that are there. */
function rangeOf(planes: readonly Float32Array[]): readonly [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const samples of planes) {
    for (const value of samples) {
      if (value < low && value !== -Infinity) low = value;
      if (value > high && value !== Infinity) high = value;
    }
  }
  return low < high ? [low, high] : [0, 1];
}

/** The field whose samples are shown. */
export function useShownField(): () => string {
  const { page, view } = useModel();
  return () => page().slicing.field ?? view()?.field ?? "";
}
