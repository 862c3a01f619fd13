/** Names of features, and what is known of them. Pure. */

import type { DerivedInfo, View, VolumeInfo } from "../../protocol/types";

/** No feature: importance is smoothness alone. */
export const NO_FEATURE = "none";
/** The feature that is derived from the field whose isosurface is shown. */
export const GRADIENT_MAGNITUDE = "gradient-magnitude";

/** Histogram and range of a view's feature; `undefined` where the server gives none. */
export function featureInfo(volume: VolumeInfo, view: Pick<View, "feature" | "field">): DerivedInfo | undefined {
  const named = (name: string) => volume.fields.find((f) => f.name === name);
  if (view.feature === GRADIENT_MAGNITUDE) return named(view.field)?.gradientMagnitude;
  return named(view.feature) ?? volume.features.find((f) => f.name === view.feature);
}

/** The feature's own range, where it is known and not empty. */
export function ownRange(info: DerivedInfo | undefined): readonly [number, number] | undefined {
  return info !== undefined && info.range[0] < info.range[1] ? info.range : undefined;
}

/** Text for the name of a field or feature; names from files stay as they are. */
export function label(name: string): string {
  return name === GRADIENT_MAGNITUDE ? "Gradient magnitude" : name === NO_FEATURE ? "None" : name;
}
