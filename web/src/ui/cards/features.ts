/** Names of features, and what is known of them. Pure. */

import type { DerivedInfo, View, VolumeInfo } from "../../protocol/types";

/** No feature: importance is smoothness alone. */
export const NO_FEATURE = "none";
/** The magnitude of the gradient of the field whose surface is shown. */
export const GRADIENT = "gradient-magnitude";

type Chosen = Pick<View, "feature" | "field">;

/** The view's feature, where it is derived from the field whose isosurface is shown. */
export function derivedFeature(volume: VolumeInfo, { feature, field }: Chosen): DerivedInfo | undefined {
  const derived = volume.fields.find((f) => f.name === field)?.derivedFeatures ?? {};
  return Object.hasOwn(derived, feature) ? derived[feature] : undefined;
}

/** Histogram and range of a view's feature; `undefined` where the server gives none. */
export function featureInfo(volume: VolumeInfo, view: Chosen): DerivedInfo | undefined {
  const named = (list: VolumeInfo["fields"]) => list.find((f) => f.name === view.feature);
  return derivedFeature(volume, view) ?? named(volume.fields) ?? named(volume.features);
}

/** The feature's own range, where it is known and not empty. */
export function ownRange(info: DerivedInfo | undefined): readonly [number, number] | undefined {
  return info !== undefined && info.range[0] < info.range[1] ? info.range : undefined;
}

/** Texts of what has no name from a file. */
const LABELS: ReadonlyMap<string, string> = new Map([
  [NO_FEATURE, "None"],
  [GRADIENT, "Gradient magnitude"],
]);

/** Text for the name of a field or feature; names from files stay as they are. */
export function label(name: string): string {
  return LABELS.get(name) ?? name;
}
