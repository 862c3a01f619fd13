/** Names of features, and what is known of them. Pure. */

import type { DerivedInfo, VolumeInfo } from "../../protocol/types";
import { derivedFeature, hasLabels, type Chosen } from "../../state/fields";

/** No feature: importance is smoothness alone. */
export const NO_FEATURE = "none";
/** The magnitude of the gradient of the field whose surface is shown. */
export const GRADIENT = "gradient-magnitude";

/** What is known of a view's feature; `undefined` if the server does not know it. */
export function featureInfo(volume: VolumeInfo, view: Chosen): DerivedInfo | undefined {
  const named = (list: VolumeInfo["fields"]) => list.find((f) => f.name === view.feature);
  return derivedFeature(volume, view) ?? named(volume.fields) ?? named(volume.features) ?? vectorFeature(volume, view.feature);
}

/** A feature that is computed from a vector field. */
function vectorFeature(volume: VolumeInfo, feature: string): DerivedInfo | undefined {
  return volume.vectors.map(({ features }) => (Object.hasOwn(features, feature) ? features[feature] : undefined)).find((info) => info !== undefined);
}

/**
 * Names of the features to choose from beside the shape and the gradient's magnitude: computed from the shown field, from vectors, other
 * fields. The shown field has one value on its own surface.
 */
export function otherFeatures(volume: VolumeInfo, field: string): readonly string[] {
  const derived = Object.keys(volume.fields.find(({ name }) => name === field)?.derivedFeatures ?? {});
  const ofVectors = volume.vectors.flatMap(({ features }) => Object.keys(features));
  const names = [...derived, ...ofVectors, ...volume.fields.map(({ name }) => name)];
  return [...new Set(names)].filter((name) => name !== GRADIENT && name !== field);
}

/** The one that is offered first: another measured field, or what is computed, or labels. `undefined` if there is none. */
export function bestOther(volume: VolumeInfo, field: string): string | undefined {
  const others = otherFeatures(volume, field);
  const ofFields = volume.fields.filter(({ name }) => others.includes(name));
  const measured = ofFields.find((known) => !hasLabels(known) && known.range[0] < known.range[1]);
  return measured?.name ?? others.find((name) => !ofFields.some((known) => known.name === name)) ?? others[0];
}

/** The field by which a surface is coloured first: another measured one if there is one, then labels, then its own. */
export function bestField({ fields }: VolumeInfo, shown: string): string {
  const others = fields.filter(({ name }) => name !== shown);
  return (others.find((known) => !hasLabels(known)) ?? others[0])?.name ?? shown;
}

/** Texts of what has no name from a file. */
const LABELS: ReadonlyMap<string, string> = new Map([
  [NO_FEATURE, "None"],
  [GRADIENT, "Gradient magnitude"],
  ["mean-curvature", "Mean curvature"],
  ["gaussian-curvature", "Gaussian curvature"],
  ["local-variance", "Texture (local variance)"],
  ["vector-magnitude", "Magnitude"],
  ["divergence", "Divergence"],
  ["vorticity-magnitude", "Vorticity"],
  ["q-criterion", "Q-criterion"],
  ["lambda2", "λ₂"],
  ["helicity", "Helicity"],
]);

/** Text for the name of a field or feature; names from files stay as they are. */
export function label(name: string): string {
  const known = LABELS.get(name);
  if (known !== undefined) return known;
  const [, feature, components] = /^([a-z0-9-]+)\((.*)\)$/.exec(name) ?? [];
  const text = LABELS.get(feature ?? "");
  return text === undefined || components === undefined ? name : `${text} of ${components.split(",").join(", ")}`;
}
