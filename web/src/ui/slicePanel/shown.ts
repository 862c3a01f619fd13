/** Which field slices show, and which of its values are black and white. */

import { createMemo } from "solid-js";
import { openingWindow } from "../../state/bounds";
import { useModel } from "../model";

/** Values that are black and white in the slices. */
export function useWindow(): () => readonly [number, number] {
  const { look, slices, volume } = useModel();
  const field = useShownField();
  return createMemo(() => {
    const name = field();
    return look().slices.window ?? openingWindow(volume(), name, () => slices().flatMap(({ loaded }) => loaded?.planes.get(name)?.samples ?? []));
  });
}

/** The field whose samples are shown. */
export function useShownField(): () => string {
  const { page, view } = useModel();
  return () => page().slicing.field ?? view()?.field ?? "";
}
