/** The slices beside the picture as parts of an image: the whole of each, drawn in the image's size. */

import type { SlicePicture } from "../image/beside";
import { pixelOf, sliceViews, type SliceView } from "../slices/view";
import { openingWindow } from "../state/bounds";
import { hasLabels } from "../state/fields";
import { crosshairOf, outlinesOf, type LoadedSlice, type SliceState } from "../state/slicing";
import type { Store } from "../state/store";
import { drawSlice, fitOf, OUTLINE, outlineIn } from "../ui/slicePanel/draw";

/** @param side pixels of the page  @param scale pixels of the image for one on the page */
export function slicePictures(store: Store, slices: readonly SliceState[], side: number, scale: number): readonly SlicePicture[] {
  const { look, page: { slicing }, view, viewer: { volume } } = store;
  if (volume === undefined || view === undefined) return [];
  const field = slicing.field ?? view.field;
  const samples = () => slices.flatMap(({ loaded }) => loaded?.planes.get(field)?.samples ?? []);
  const window = look.slices.window ?? openingWindow(volume, field, samples);
  const info = volume.fields.find(({ name }) => name === field);
  const at = crosshairOf(slicing, volume.geometry.dims);
  const outlines = (loaded: LoadedSlice) =>
    outlinesOf(store.surfaces).flatMap((outline) => {
      const segments = outlineIn(loaded, outline, volume.fields);
      return segments === undefined ? [] : [{ color: outline.color ?? OUTLINE, segments }];
    });
  const pictureOf = (sliceView: SliceView): SlicePicture[] => {
    const loaded = slices[sliceView.across]?.loaded;
    if (loaded === undefined) return [];
    const canvas = document.createElement("canvas");
    const fit = fitOf(sliceView, side, side);
    drawSlice(canvas, side, side, scale, { view: sliceView, loaded, field, window, isSmooth: info === undefined || !hasLabels(info), outlines: outlines(loaded) }, fit);
    const [x, y] = pixelOf(sliceView, fit, at[sliceView.axes[0]], at[sliceView.axes[1]]);
    return [{ canvas, title: `${sliceView.name} ${loaded.index}`, sides: sliceView.sides, cross: [x / side, y / side] }];
  };
  return sliceViews(volume.geometry, slicing.leftIsLeft).flatMap(pictureOf);
}
