/** Images and turntables of the scene as files. What composes them is loaded when one is asked for. */

import { colorBarOf } from "./display";
import { signOf } from "./surfaceSigns";
import type { ImageParts } from "../image/compose";
import type { CameraPose } from "../scene/pose";
import type { SurfaceRenderer } from "../scene/renderer";
import { withRanges } from "../state/featureRanges";
import { lengthUnit } from "../state/lengths";
import { shownErrors } from "../state/shownErrors";
import type { SliceState } from "../state/slicing";
import type { Store } from "../state/store";
import { coloredByLook } from "../state/surfaceList";
import type { ImageRequest } from "../ui/actions";
import { theme } from "../ui/theme";

/** Of the page's surroundings in images: the middle of what the page shows. */
const BACKDROPS = { page: { dark: "#171b21", light: "#f4f6f8" }, black: { dark: "#000000", light: "#000000" }, white: { dark: "#ffffff", light: "#ffffff" } } as const;
/** Of texts and lines. */
const INKS = { dark: "#e8ebef", light: "#18202a" } as const;
/** Side of a slice in an image of slices alone, pixels of the page. */
const SLICE_SIDE = 420;
/** The scale bar is no wider than this share of the picture. */
const WIDEST_BAR = 0.2;

/** A file, and what the user has to know of it. */
export interface Made {
  readonly blob: Blob;
  readonly note: string | undefined;
}

/** Why an image has no scale bar. */
const WITHOUT_BAR = "without a scale bar, as lengths differ by more than 5 % over its middle: an orthographic view has one";

/** A PNG of what is seen from a pose. */
export async function makeImage(scene: SurfaceRenderer, store: Store, request: ImageRequest, pose: CameraPose, slices: readonly SliceState[] = []): Promise<Made> {
  const layout = request.slices ? store.page.slicing.layout : "picture";
  const { scale } = request;
  const { drawImage, toPng } = await import("../image/compose");
  const beside = layout === "picture" ? undefined : await loadSlices();
  if (layout === "slices" && beside !== undefined) {
    return { blob: await toPng(beside.place(undefined, beside.pictures(store, slices, SLICE_SIDE, scale), SLICE_SIDE * scale, scale)), note: undefined };
  }
  const snapshot = scene.snapshot({ scale, transparent: true, pose });
  const picture = drawImage(snapshot, imageParts(scene, store, request));
  // On the right of the picture.
  const side = Math.floor(snapshot.height / 3);
  const image = beside === undefined ? picture : beside.place(picture, beside.pictures(store, slices, side / scale, scale), side, scale);
  return { blob: await toPng(image), note: request.scaleBar && snapshot.unitsPerPixel === undefined ? WITHOUT_BAR : undefined };
}

async function loadSlices() {
  const [{ placeBeside }, { slicePictures }] = await Promise.all([import("../image/beside"), import("./sliceImages")]);
  return { place: placeBeside, pictures: slicePictures };
}

/** A turn around the surface as numbered PNGs in a zip. */
export async function makeTurn(
  scene: SurfaceRenderer,
  store: Store,
  request: ImageRequest,
  frames: number,
  onProgress: (done: number) => void,
  signal: AbortSignal,
): Promise<Made> {
  const { makeTurntable } = await import("../image/turntable");
  const { scale } = request;
  let withoutBar = 0;
  const blob = await makeTurntable((pose) => {
    const snapshot = scene.snapshot({ scale, transparent: true, pose });
    withoutBar += snapshot.unitsPerPixel === undefined ? 1 : 0;
    return snapshot;
  }, {
    frames,
    from: scene.camera.pose,
    parts: imageParts(scene, store, request),
    onProgress,
    signal,
  });
  return { blob, note: request.scaleBar && withoutBar > 0 ? `${withoutBar} of ${frames} ${WITHOUT_BAR}` : undefined };
}

/** Parts that are composed with a picture. */
export function imageParts(scene: SurfaceRenderer, store: Store, request: ImageRequest): ImageParts {
  const { look, viewer } = store;
  const surfaces = withRanges(viewer, store.surfaces);
  const page = theme();
  const colored = request.colorBar ? coloredByLook(surfaces, viewer.selected) : undefined;
  const colors = colored && colorBarOf(look, colored.view, shownErrors(viewer, surfaces), lengthUnit(viewer.volume), viewer.volume);
  const signs = surfaces.filter(({ style }) => style.visible).map((surface) => signOf(surface, store));
  // A transparent image gets dark ink, which can be read on white paper: its background is not known.
  const isDark = !request.transparent && (look.background === "black" || (look.background === "page" && page === "dark"));
  return {
    ...(request.transparent ? {} : { background: BACKDROPS[look.background][page] }),
    ink: isDark ? INKS.dark : INKS.light,
    scale: request.scale,
    ...(colors === undefined ? {} : { colorBar: colors }),
    ...(request.scaleBar ? { scaleBar: (unitsPerPixel: number) => scene.annotations.barFor(unitsPerPixel, WIDEST_BAR * scene.size.width * request.scale) } : {}),
    ...(request.isovalues && signs.length > 1 ? { isovalues: signs } : {}),
    ...(request.caption === "" ? {} : { caption: request.caption }),
  };
}
