/** The isosurfaces of the open volume as the user wants them: what each shows, and how it looks. Pure. */

import { hasBudget, withBudget } from "../protocol/view";
import type { Edit, View } from "../protocol/types";
import { complete } from "../protocol/view";

/** How one of the surfaces looks; the look has what is common to all. */
export interface SurfaceStyle {
  readonly visible: boolean;
  /** 0 to 1; below 1 what lies behind it shines through. */
  readonly opacity: number;
  /** A colour of its own, `#rrggbb`; without one it has the colours of the look. */
  readonly color: string | undefined;
}

export interface Surface {
  /** On the connection and in chunks. */
  readonly number: number;
  readonly view: View;
  readonly style: SurfaceStyle;
}

/** One or more, in the order in which they were added. */
export type SurfaceList = readonly Surface[];

/** As many as the header of a chunk can number. */
export const MAX_SURFACES = 4;

export const DEFAULT_STYLE: SurfaceStyle = { visible: true, opacity: 1, color: undefined };

/** Of surfaces that are added: apart from each other and from the materials, for colour-blind eyes too. */
export const OWN_COLORS = ["#e08a5b", "#74b3e8", "#e3c12f", "#2a7a64"] as const;

/** Of a surface around another one. */
export const OUTER_OPACITY = 0.35;

/** With an edit of one of them. A budget is one for all that have one. */
export function edited(list: SurfaceList, number: number, edit: Edit): SurfaceList {
  const change = complete(edit);
  const of = list.map((surface) => (surface.number === number ? { ...surface, view: { ...surface.view, ...change } } : surface));
  return hasBudget(edit) ? sharing(of, number) : of;
}

/** All that have a budget have that of one of them. */
function sharing(list: SurfaceList, number: number): SurfaceList {
  const budget = list.find((surface) => surface.number === number)?.view;
  if (budget === undefined) return list;
  return list.map((surface) => (surface.number === number ? surface : { ...surface, view: withBudget(surface.view, budget) }));
}

export function styled(list: SurfaceList, number: number, style: Partial<SurfaceStyle>): SurfaceList {
  return list.map((surface) => (surface.number === number ? { ...surface, style: { ...surface.style, ...style } } : surface));
}

/**
 * Adds a surface that is a copy of another one, except for its isovalue and its colour. Surfaces of lower values become translucent,
 * because they mostly lie around those of higher values and would hide them.
 */
export function added(list: SurfaceList, like: Surface, iso: number): SurfaceList {
  const number = freeNumber(list);
  if (number === undefined) return list;
  const all = [...list, { number, view: { ...like.view, iso }, style: { ...DEFAULT_STYLE, color: freeColor(list) } }];
  const isAround = ({ view }: Surface) => all.some((inner) => inner.view.field === view.field && inner.view.iso > view.iso);
  return all.map((surface) => {
    const hides = surface.view.field === like.view.field && surface.style.opacity === 1 && isAround(surface);
    return hides ? { ...surface, style: { ...surface.style, opacity: OUTER_OPACITY } } : surface;
  });
}

/** The surfaces that have the colours of the look: those that are seen and have no colour of their own. */
export function allColoredByLook(surfaces: SurfaceList): SurfaceList {
  return surfaces.filter(({ style }) => style.color === undefined && style.visible);
}

/** Of these the one that a colour bar is about: the selected one, or the first. */
export function coloredByLook(surfaces: SurfaceList, selected: number): Surface | undefined {
  const colored = allColoredByLook(surfaces);
  return colored.find(({ number }) => number === selected) ?? colored[0];
}

/** One that no surface has. */
export function freeColor(list: SurfaceList): string {
  return OWN_COLORS.find((own) => list.every(({ style }) => style.color !== own)) ?? OWN_COLORS[0];
}

/** Without one of them; the last one stays. */
export function removed(list: SurfaceList, number: number): SurfaceList {
  return list.length > 1 ? list.filter((surface) => surface.number !== number) : list;
}

/** The surface that is selected in its place: the one before it, or the first. */
export function besides(list: SurfaceList, number: number): number {
  const at = list.findIndex((surface) => surface.number === number);
  return (list[at - 1] ?? list[at + 1] ?? list[0])?.number ?? 0;
}

/** As many as a server allows, with numbers that it takes. */
export function limited(list: SurfaceList, max: number): SurfaceList {
  const some = list.slice(0, Math.max(1, max));
  return some.length === list.length && some.every(({ number }) => number < max) ? list : some.map((surface, number) => ({ ...surface, number }));
}

/** From what a link names of each. */
export function listOf(opening: View, wanted: readonly { readonly edit: Edit; readonly style: Partial<SurfaceStyle> }[]): SurfaceList {
  const list = wanted.map(({ edit, style }, number) => ({ number, view: { ...opening, ...complete(edit) }, style: { ...DEFAULT_STYLE, ...style } }));
  const first = list.find(({ view }) => hasBudget(view));
  return first === undefined ? list : sharing(list, first.number);
}

/** The number of a further surface; `undefined` if there are as many as can be. */
export function freeNumber(list: SurfaceList): number | undefined {
  return Array.from({ length: MAX_SURFACES }, (_, number) => number).find((number) => list.every((surface) => surface.number !== number));
}
