/** What a view has that depends on its field: isovalue, and the range of a feature that is derived from it. Pure. */

import type { DerivedInfo, Edit, View, VolumeInfo } from "../protocol/types";

export type Chosen = Pick<View, "feature" | "field">;

/** Whether a field's values are labels: the file says so, or it opens around labels. */
export const hasLabels = ({ labels, openingIso }: Pick<VolumeInfo["fields"][number], "labels" | "openingIso">): boolean => labels !== undefined || openingIso?.reason === "labels";

/** The view's feature, if it is derived from the field whose isosurface is shown. */
export function derivedFeature(volume: VolumeInfo, { feature, field }: Chosen): DerivedInfo | undefined {
  const derived = volume.fields.find((f) => f.name === field)?.derivedFeatures ?? {};
  return Object.hasOwn(derived, feature) ? derived[feature] : undefined;
}

/**
 * The feature's own range, if it is known and not empty. Of a computed feature with both signs the server chooses the range: magnitudes
 * count.
 */
export function ownRange(info: DerivedInfo | undefined): readonly [number, number] | undefined {
  const range = info?.range;
  if (range === undefined || !(range[0] < range[1])) return undefined;
  return range[0] < 0 && !isField(info) ? undefined : range;
}

function isField(info: DerivedInfo | undefined): boolean {
  return info !== undefined && "name" in info;
}

/** The edit that shows another field's surface: with the isovalue that it opens with, and what is derived from it. */
export function fieldEdit(volume: VolumeInfo, view: Pick<View, "feature" | "iso">, name: string): Edit {
  const field = volume.fields.find((f) => f.name === name);
  const derived = derivedFeature(volume, { feature: view.feature, field: name });
  const iso = field?.openingIso?.iso ?? view.iso;
  return { field: name, iso, ...(derived === undefined ? {} : { featureRange: ownRange(derived) }) };
}

/**
 * The edit of a link that a user wrote by hand, with another field and no isovalue: the isovalue of the previous field means nothing there.
 */
export function ofItsField(wanted: Edit, opening: View, volume: VolumeInfo | undefined): Edit {
  // A range is one of its feature.
  const isOther = wanted.feature !== undefined && wanted.feature !== "none" && wanted.feature !== opening.feature && wanted.featureRange === undefined;
  const free = isOther ? { featureRange: undefined } : {};
  const edit = { ...free, ...wanted };
  const { field, iso, feature = opening.feature } = edit;
  if (volume === undefined || field === undefined || field === opening.field || iso !== undefined) return edit;
  return { ...free, ...fieldEdit(volume, { feature, iso: opening.iso }, field), ...wanted };
}
