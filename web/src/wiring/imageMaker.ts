/** Images and turntables of the scene as files. What composes them is loaded when one is asked for. */

import { colorBarOf } from "./display";
import { signOf } from "./surfaceSigns";
import type { ImageParts } from "../image/compose";
import type { SurfaceRenderer } from "../scene/renderer";
import { lengthUnit } from "../state/lengths";
import { shownErrors } from "../state/shownErrors";
import type { Store } from "../state/store";
import { coloredByLook } from "../state/surfaceList";
import type { ImageRequest } from "../ui/model";
import { theme } from "../ui/theme";

/** Of the page's surroundings in images: the middle of what the page shows. */
const BACKDROPS = { page: { dark: "#171b21", light: "#f4f6f8" }, black: { dark: "#000000", light: "#000000" }, white: { dark: "#ffffff", light: "#ffffff" } } as const;
/** Of texts and lines. */
const INKS = { dark: "#e8ebef", light: "#18202a" } as const;
/** The scale bar is no wider than this share of the picture. */
const WIDEST_BAR = 0.2;

/** A PNG of what is seen. */
export async function makeImage(scene: SurfaceRenderer, store: Store, request: ImageRequest): Promise<Blob> {
  const { composeImage } = await import("../image/compose");
  const snapshot = scene.snapshot({ scale: request.scale, transparent: true });
  return composeImage(snapshot, parts(scene, store, request, snapshot));
}

/** A turn around the surface as numbered PNGs in a zip. */
export async function makeTurn(
  scene: SurfaceRenderer,
  store: Store,
  request: ImageRequest,
  frames: number,
  onProgress: (done: number) => void,
  signal: AbortSignal,
): Promise<Blob> {
  const { makeTurntable } = await import("../image/turntable");
  const { scale } = request;
  const unitsPerPixel = scene.camera.heightAtTarget / (scene.size.height * scale);
  return makeTurntable((pose) => scene.snapshot({ scale, transparent: true, pose }), {
    frames,
    from: scene.camera.pose,
    parts: parts(scene, store, request, { width: scene.size.width * scale, unitsPerPixel }),
    onProgress,
    signal,
  });
}

function parts(scene: SurfaceRenderer, store: Store, request: ImageRequest, of: { readonly width: number; readonly unitsPerPixel: number }): ImageParts {
  const { look, surfaces, viewer } = store;
  const page = theme();
  const colored = request.colorBar ? coloredByLook(surfaces, viewer.selected) : undefined;
  const colors = colored && colorBarOf(look, colored.view.transferFunction.points, shownErrors(viewer, surfaces), lengthUnit(viewer.volume));
  const signs = surfaces.filter(({ style }) => style.visible).map((surface) => signOf(surface, store));
  // On white paper, where nobody knows the background, dark ink is read.
  const isDark = !request.transparent && (look.background === "black" || (look.background === "page" && page === "dark"));
  return {
    ...(request.transparent ? {} : { background: BACKDROPS[look.background][page] }),
    ink: isDark ? INKS.dark : INKS.light,
    scale: request.scale,
    ...(colors === undefined ? {} : { colorBar: colors }),
    ...(request.scaleBar ? { scaleBar: scene.annotations.barFor(of.unitsPerPixel, WIDEST_BAR * of.width) } : {}),
    ...(request.isovalues && signs.length > 1 ? { isovalues: signs } : {}),
    ...(request.caption === "" ? {} : { caption: request.caption }),
  };
}
