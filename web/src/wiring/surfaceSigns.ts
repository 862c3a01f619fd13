/** How files and images tell surfaces apart: by colour and isovalue. Pure. */

import type { SurfaceSign } from "../image/compose";
import { SHADINGS } from "../scene/look";
import { withRange } from "../state/featureRanges";
import { labelsName } from "../state/labels";
import type { Look } from "../state/look";
import { shownErrors } from "../state/shownErrors";
import type { Store } from "../state/store";
import type { Surface } from "../state/surfaceList";
import { formatValue } from "../ui/format";
import { colorBarOf } from "./display";

/**
 * The one colour of a surface; `undefined` if its vertices have the transfer function's. For what a file cannot show it is the material's.
 */
export function colorOf({ style }: Pick<Surface, "style">, { colorBy, material }: Pick<Look, "colorBy" | "material">): string | undefined {
  if (style.color !== undefined) return style.color;
  return colorBy === "transfer" ? undefined : SHADINGS[material].color;
}

/** The colours of a surface as they are seen, and its isovalue: `T1 90`, with the unit if the field has one. */
export function signOf({ number, style, view }: Surface, { look, surfaces, viewer }: Pick<Store, "look" | "surfaces" | "viewer">): SurfaceSign {
  const bar = style.color === undefined ? colorBarOf(look, withRange(viewer, { number, view }), shownErrors(viewer, surfaces), undefined) : undefined;
  const unit = viewer.volume?.fields.find(({ name }) => name === view.field)?.unit ?? "";
  return { stops: bar?.stops ?? [style.color ?? SHADINGS[look.material].color], opacity: style.opacity, text: labelsName(viewer.volume, view.field) ?? `${view.field} ${formatValue(view.iso)} ${unit}`.trim() };
}
