/** Names of the surfaces, by their places in the list. Pure except for `useSurfaceName`. */

import type { SurfaceList } from "../state/surfaceList";
import { linearColor } from "../transfer/model";
import { useModel } from "./model";

/** `2`; by the surface's number on the connection, which is another one after some were removed. */
export function placeOf(surfaces: SurfaceList, number: number): number {
  return surfaces.findIndex((surface) => surface.number === number) + 1;
}

/** `surface 2`; empty if there is one alone. */
export function surfaceName(surfaces: SurfaceList, number: number | undefined): string {
  const place = number === undefined ? 0 : placeOf(surfaces, number);
  return surfaces.length > 1 && place > 0 ? `surface ${place}` : "";
}

/** The selected surface's. */
export function useSurfaceName(): () => string {
  const { selected, surfaces } = useModel();
  return () => surfaceName(surfaces(), selected()?.number);
}

/** How many surfaces are seen. */
export function useVisibleCount(): () => number {
  const { surfaces } = useModel();
  return () => surfaces().filter(({ style }) => style.visible).length;
}

/** Black or white, whichever is easier to read on a colour. */
export function inkOn(color: string): string {
  const [r, g, b] = linearColor(color);
  const luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
  return luminance > 0.18 ? "#000000" : "#ffffff";
}
