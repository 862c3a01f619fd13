/** Shows the look in the scene: colours, what is cut away, slices, what is drawn beside the surface. */

import { isEqual } from "../protocol/equal";
import { COLOR_MAPS, colorAt, colorTable, DISTANCE_COLORS } from "../colors/maps";
import type { TransferFunction, View, VolumeInfo } from "../protocol/types";
import type { ColoredRegion } from "../scene/coloredRegions";
import type { ColorBar } from "../scene/colorScale";
import type { SurfaceRenderer } from "../scene/renderer";
import { SliceLoader, type SliceSource } from "./sliceLoader";
import { VolumeDisplay } from "./volumeDisplay";
import type { Distances } from "../state/distances";
import { lengthUnit, unitWord } from "../state/lengths";
import type { ColorBy, Look } from "../state/look";
import type { SurfaceState } from "../state/surfaceState";
import { coloredByLook, type Surface, type SurfaceList } from "../state/surfaceList";
import { LEVEL_COLORS, mappedLut, rampLut, transferLut } from "../transfer/lut";
import { IDENTITY } from "../transfer/model";
import { fieldBarOf, fieldScaleOf, linePlaces, type FieldScale } from "../ui/cards/fieldColors";
import { formatValue } from "../ui/format";
import type { Theme } from "../ui/theme";
import { physicalAxes } from "../world/physicalAxes";

type Points = TransferFunction["points"];

/** Colours of a field, of which vertices have 257 values. */
const FIELD_COLORS = 257;

/** What the scene looks up. */
const MODES = { material: "material", transfer: "transfer", feature: "transfer", field: "field", importance: "transfer", level: "level", error: "value" } as const;

/** Colours of a scene that nothing is known of yet. */
export const FIRST_TABLES = { transfer: transferLut(IDENTITY), importance: rampLut(COLOR_MAPS.batlow), levels: LEVEL_COLORS };

/** What the colours mean; `undefined` if there is nothing to say of them, or the distances are not known yet. */
export function colorBarOf(
  look: Look,
  view: View | undefined,
  distances: Distances | undefined,
  unit: string | undefined,
  volume?: VolumeInfo,
): ColorBar | undefined {
  const { colorBy, map } = look;
  if (colorBy === "error") return distances && distanceBar(distances, unit);
  if (colorBy === "field") {
    const scale = view && fieldScaleOf(look, view, volume);
    return view && scale && { ...fieldBarOf(scale, view, volume), stops: COLOR_MAPS[map] };
  }
  const points = view?.transferFunction.points;
  const ends = { texts: ["0", "0.5", "1"] };
  if (colorBy === "feature") return { ...ends, stops: COLOR_MAPS[map], title: "Blended value" };
  if (colorBy === "importance") return { ...ends, stops: COLOR_MAPS[map], title: "Importance" };
  if (colorBy === "transfer" && points !== undefined) return { ...ends, stops: stopsOf(transferLut(points, 64)), title: "Blended value" };
  if (colorBy !== "level") return undefined;
  // Steps, with a number in the middle of each.
  const texts = LEVEL_COLORS.flatMap((_, level) => ["", String(level)]);
  return { stops: LEVEL_COLORS.flatMap((color) => new Array<string>(16).fill(color)), texts: [...texts, ""], title: "Level" };
}

function distanceBar({ upper }: Distances, unit: string | undefined): ColorBar {
  return { stops: DISTANCE_COLORS, texts: ["0", formatValue(upper / 2), `≥ ${formatValue(upper)}`], title: `Off by, in ${unitWord(unit)}` };
}

function stopsOf(table: Uint8Array): string[] {
  const hex = (byte: number | undefined) => (byte ?? 0).toString(16).padStart(2, "0");
  return Array.from({ length: table.length / 4 }, (_, i) => `#${hex(table[4 * i])}${hex(table[4 * i + 1])}${hex(table[4 * i + 2])}`);
}

/** Colours and importance over the blended value. */
function tableOf({ colorBy, map }: Look, points: Points): Uint8Array<ArrayBuffer> {
  if (colorBy === "field") return rampLut(COLOR_MAPS[map], FIELD_COLORS);
  return colorBy === "feature" || colorBy === "importance" ? mappedLut(points, COLOR_MAPS[map], colorBy) : transferLut(points);
}

/** Regions of interest in the colours of their importance, if colours show that. */
function regionsOf({ colorBy, map }: Look, interest: View["interest"]): readonly ColoredRegion[] {
  if (colorBy !== "importance") return [];
  return interest.map(({ sphere, box, importance }) => ({ ball: sphere, box, importance, color: colorAt(COLOR_MAPS[map], importance) }));
}

/** Colours of a field stand for other values. */
function isRescaled(look: Look, before: Look): boolean {
  return look.colorRange !== before.colorRange || look.logColors !== before.logColors || look.isolines !== before.isolines;
}

/** Values that the vertices on screen have. */
interface ShownValues {
  /** Distances of the surfaces that have the colours of the look, as soon as they are known. */
  readonly distances: Distances | undefined;
  /** By the numbers of surfaces: the field of each. */
  readonly known: ReadonlyMap<number, Pick<SurfaceState, "shownField">>;
}

/** Whether the vertices on screen have the values of the field that colours of mode `field` are of. They always have the feature. */
function isFieldShown({ number, view }: Surface, known: ShownValues["known"]): boolean {
  return view.colorField === null || view.colorField === known.get(number)?.shownField;
}

export class Display {
  /** The requested look, and the part of it that is shown. */
  private wanted: Look | undefined;
  private look: Look | undefined;
  private distances: Distances | undefined;
  /** What colours stood for before values of vertices were asked for: they stand for it until these are known. */
  private otherColors: ColorBy = "material";
  /** What the scene shows for each surface. */
  private readonly shown = new Map<number, Surface>();
  /** What the colour bar says: control points, the field that matters and its range, the volume. */
  private bar: readonly unknown[] | undefined;
  /** Scales of the fields of surfaces. */
  private readonly fields = new Map<number, FieldScale>();
  private readonly slices: SliceLoader;
  private readonly volume: VolumeDisplay;
  private unit: string | undefined;

  /** @param onError what cannot be shown, for the user */
  constructor(
    private readonly scene: SurfaceRenderer,
    base: URL,
    onError: (reason: string) => void,
    private readonly isEmbedded = false,
  ) {
    this.slices = new SliceLoader((slices) => this.scene.setSlices(slices), onError, base);
    this.volume = new VolumeDisplay(scene, base, onError);
  }

  /**
   * An unchanged display costs no frame, which would delay the one that is waited for. If colours are those of a field, this is called when
   * meshes change too, so that colours and values change in the same frame.
   */
  show(wanted: Look, surfaces: SurfaceList, selected: number, source: SliceSource, { distances, known }: ShownValues): void {
    const before = this.look;
    const colored = coloredByLook(surfaces, selected);
    const legend = colored?.view;
    const hasField = before?.colorBy === "field" || colored === undefined || isFieldShown(colored, known);
    const look = this.lookFor(wanted, (wanted.colorBy === "error" && distances === undefined) || (wanted.colorBy === "field" && !hasField));
    if (look !== before) this.showLook(look, before);
    const isRecolored = look.colorBy !== before?.colorBy || look.map !== before.map || isRescaled(look, before) || distances?.upper !== this.distances?.upper;
    [this.wanted, this.look, this.distances] = [wanted, look, distances];
    for (const surface of surfaces) {
      this.showSurface(look, surface, isRecolored);
      if (look.colorBy === "field" && isFieldShown(surface, known)) this.showField(look, surface, legend, source.volume);
    }
    this.hideOthers(surfaces);
    if (distances !== undefined && isRecolored) this.scene.colors.setValueColors(0, distances.upper, colorTable(DISTANCE_COLORS));
    this.showColorBar(look, legend, source.volume, isRecolored);
    this.slices.show(look.slices, source);
    this.volume.show(look, source.volume, source.step, surfaces.find(({ number }) => number === selected));
  }

  setTheme(theme: Theme): void {
    this.scene.setEdgeColor(theme === "dark" ? "#0b0e12" : "#101418");
    this.volume.setTheme(theme);
  }

  /** The volume that is shown: unit and axes of its world. */
  place(volume: VolumeInfo): void {
    this.unit = lengthUnit(volume);
    this.scene.annotations.unit = this.unit ?? "";
    this.scene.annotations.physicalAxes = physicalAxes(volume.geometry, volume.axes);
  }

  private showLook(look: Look, before: Look | undefined): void {
    const { scene } = this;
    const { colorBy, material, flat, wireframe, background, occlusion, silhouettes } = look;
    const colorMode = MODES[colorBy];
    scene.setLook({ colorMode, material, flat, wireframe, background, occlusion, silhouettes });
    scene.setFinestLevel(look.finestLevel);
    scene.annotations.show({ axes: look.axes, scale: look.scale, box: look.box });
    if (look.exaggeration !== (before?.exaggeration ?? 1)) scene.exaggeration = look.exaggeration;
    if (look.clip !== before?.clip) scene.setClip(look.clip);
    const projection = look.orthographic ? "orthographic" : "perspective";
    if (scene.camera.projection !== projection) scene.camera.projection = projection;
  }

  /** The look; with the former colours if vertices do not have the values yet that it is to show. */
  private lookFor(wanted: Look, awaits: boolean): Look {
    if (wanted.colorBy !== "error" && !awaits) this.otherColors = wanted.colorBy;
    // The look that was requested is shown itself unless its values were missing.
    if (this.look !== undefined && wanted === this.wanted && awaits === (this.look !== wanted)) return this.look;
    return awaits ? { ...wanted, colorBy: this.otherColors } : wanted;
  }

  private showSurface(look: Look, surface: Surface, isRecolored: boolean): void {
    const { number, view, style } = surface;
    const before = this.shown.get(number);
    this.shown.set(number, surface);
    const { points } = view.transferFunction;
    const isChanged = points !== before?.view.transferFunction.points || view.interest !== before.view.interest;
    if (isRecolored || isChanged) this.scene.colors.setTransfer(tableOf(look, points), number, regionsOf(look, view.interest));
    if (style !== before?.style) this.scene.setSurfaceStyle(number, style);
    // The field alone, whatever its weight against the shape.
    this.scene.colors.setAlpha(look.colorBy === "field" ? 1 : view.alpha, number);
  }

  /** The values on the surface as the range of an expression whose range is not known. */
  private scaleOfSurface({ number, view }: Surface): FieldScale | undefined {
    if (view.colorField === null) return undefined;
    const range = this.scene.colors.span(number, "values");
    return range && range[0] < range[1] ? { ofValues: true, known: range, range, log: false, lines: [] } : undefined;
  }

  private showField(look: Look, surface: Surface, legend: View | undefined, volume: VolumeInfo | undefined): void {
    const { number, view } = surface;
    const scale = fieldScaleOf(look, view, volume, legend) ?? this.scaleOfSurface(surface);
    if (scale === undefined) return;
    const field = { ...scale, lines: linePlaces(scale) };
    if (isEqual(this.fields.get(number), field)) return;
    this.fields.set(number, field);
    this.scene.colors.setField(field, number);
  }

  /** What was removed is not seen any more, though its meshes are there until the server has removed it too. */
  private hideOthers(surfaces: SurfaceList): void {
    for (const number of this.shown.keys()) {
      if (surfaces.some((surface) => surface.number === number)) continue;
      this.shown.delete(number);
      this.scene.setSurfaceStyle(number, { visible: false });
    }
  }

  private showColorBar(look: Look, view: View | undefined, volume: VolumeInfo | undefined, isRecolored: boolean): void {
    const decides = view && [view.transferFunction.points, view.feature, view.featureRange, view.colorField, volume?.id];
    if (!isRecolored && decides?.length === this.bar?.length && (decides ?? []).every((value, i) => value === this.bar?.[i])) return;
    this.bar = decides;
    // The editor, if there is one, shows its own colours, and the page has a list of the levels and a legend of the field.
    const isSaid = look.colorBy === "level" || ((look.colorBy === "transfer" || look.colorBy === "field") && !this.isEmbedded);
    this.scene.annotations.showColors(!isSaid && view !== undefined ? colorBarOf(look, view, this.distances, this.unit, volume) : undefined);
  }
}
