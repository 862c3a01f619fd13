/** Annotations drawn besides the surface, for orientation: axes cube, scale bar, bounding box, markers, handles. */

import type { Box3, OrthographicCamera, PerspectiveCamera, Scene } from "three";
import type { AxisName } from "../world/axes";
import type { PhysicalAxis } from "../world/physicalAxes";
import { BoundingBox } from "./boundingBox";
import { ClipHandles } from "./clipHandles";
import { NO_CLIP, type Clip } from "./clipping";
import { ColorScale, type ColorBar } from "./colorScale";
import { Crosshair, type CrosshairPlace } from "./crosshair";
import { isBehind } from "./hiddenPlaces";
import { Markers, type Marker } from "./markers";
import { AxesCube, ScaleBar } from "./orientation";
import { Outlines, type Outlined } from "./outlines";
import { Rulers, type Ruler } from "./rulers";
import { Overlay, type Label } from "./overlay";
import { heightAt } from "./scale";
import { Swipe } from "./swipe";

/** Choice of shown annotations. */
export interface AnnotationChoice {
  readonly axes: boolean;
  readonly scale: boolean;
  readonly box: boolean;
  /** Handles of the clip plane and box, if there are any. */
  readonly handles: boolean;
}

const DEFAULT_ANNOTATIONS: AnnotationChoice = { axes: true, scale: true, box: false, handles: true };

export interface AnnotationHandlers {
  readonly onView: (axis: AxisName) => void;
  readonly onClip: (clip: Clip) => void;
  /** An annotation has changed. */
  readonly onChange: () => void;
}

export class Annotations {
  readonly swipe: Swipe;
  private readonly overlay: Overlay;
  private readonly cube: AxesCube;
  private worldFrame: string | undefined;
  private readonly bar = new ScaleBar();
  private readonly bounding = new BoundingBox();
  private readonly markers = new Markers();
  private readonly rulers = new Rulers();
  private readonly outlines = new Outlines();
  private readonly crosshair = new Crosshair();
  private isPointed = false;
  private readonly colors = new ColorScale();
  private readonly handles: ClipHandles;
  private choice = DEFAULT_ANNOTATIONS;

  constructor(
    container: HTMLElement,
    /** Scene that is rendered over the surface. */
    private readonly scene: Scene,
    private readonly handlers: AnnotationHandlers,
  ) {
    this.overlay = new Overlay(container);
    this.cube = new AxesCube(handlers.onView);
    this.handles = new ClipHandles(handlers.onClip);
    this.swipe = new Swipe(handlers.onChange);
    this.overlay.element.append(this.bar.element, this.handles.element, this.swipe.element, this.colors.element, this.cube.element);
  }

  get value(): AnnotationChoice {
    return this.choice;
  }

  show(change: Partial<AnnotationChoice>): void {
    this.choice = { ...this.choice, ...change };
    this.handlers.onChange();
  }

  /** The world's unit, such as `mm`; may be empty. */
  set unit(unit: string) {
    this.bar.unit = unit;
    this.bounding.unit = unit;
    this.handlers.onChange();
  }

  /** What positions along the world's axes are: the ticks of the box are at round ones. */
  set physicalAxes(axes: readonly (PhysicalAxis | undefined)[]) {
    this.bounding.axes = axes;
    this.handlers.onChange();
  }

  /** Factor by which heights are exaggerated: the scale bar states it. */
  set exaggeration(factor: number) {
    this.bar.exaggeration = factor;
    this.handlers.onChange();
  }

  /** The sides of a patient stand on the axes cube, in a frame that has them. */
  set frame(frame: string | undefined) {
    this.worldFrame = frame;
    this.cube.frame = frame;
    this.handlers.onChange();
  }

  get frame(): string | undefined {
    return this.worldFrame;
  }

  mark(markers: readonly Marker[]): void {
    this.markers.set(markers);
    this.handlers.onChange();
  }

  /** Shows exactly these lines with texts between places. */
  measure(rulers: readonly Ruler[]): void {
    this.rulers.set(rulers);
    this.handlers.onChange();
  }

  /** Shows exactly these outlines of regions on screen, not in images. @param strong number of the one under the pointer */
  outline(regions: readonly Outlined[], strong: number | undefined): void {
    this.outlines.set(regions, strong);
    this.handlers.onChange();
  }

  /** A crosshair through a place of the volume, on screen, not in images; `undefined`: none. */
  point(place: CrosshairPlace | undefined): void {
    this.isPointed = place !== undefined;
    if (place !== undefined) this.crosshair.place(place);
    this.handlers.onChange();
  }

  /** Whether an annotation extends over the whole volume, beyond the surface. */
  get fillsVolume(): boolean {
    return this.choice.box || this.isPointed;
  }

  /** Shows a colour bar beside the picture; `undefined`: none. */
  showColors(bar: ColorBar | undefined): void {
    this.colors.show(bar);
  }

  resize(width: number, height: number): void {
    this.overlay.resize(width, height);
  }

  /** Colour of the box' lines: the page's text, softened. */
  set lineColor(style: string) {
    this.bounding.style = style;
  }

  /**
   * Updates all annotations for the camera.
   * @param depth of the surface at the centre, at which the scale bar holds
   */
  update(camera: PerspectiveCamera | OrthographicCamera, box: Box3, clip: Clip, depth: number): void {
    const { axes, scale } = this.choice;
    this.cube.element.style.display = axes ? "" : "none";
    if (axes) this.cube.update(camera);
    this.bar.element.hidden = !scale || box.isEmpty();
    if (scale) this.measureAt(camera, depth);
    this.overlay.label(this.place(camera, box, 1), camera);
    if (this.outlines.object.children.length > 0) this.scene.add(this.outlines.object);
    this.crosshair.scale = 1;
    if (this.isPointed) this.scene.add(this.crosshair.object);
    this.handles.update(this.choice.handles && !box.isEmpty() ? clip : NO_CLIP, box, camera, this.overlay.size);
  }

  /** Texts stand at places that may be behind the surface. */
  get hasPlaces(): boolean {
    return this.overlay.hasPlaces;
  }

  /** Makes texts fainter whose places are behind the surface. @param depths see `isBehind` */
  fade(camera: PerspectiveCamera | OrthographicCamera, depths: readonly number[]): void {
    this.overlay.fade(({ at }) => isBehind(at, camera, depths));
  }

  /** Shows the scale at a depth. */
  measureAt(camera: PerspectiveCamera | OrthographicCamera, depth: number): void {
    this.bar.update(heightAt(camera, depth) / this.overlay.size.height, camera.projectionMatrix.elements[15] === 1 ? "" : "at the centre");
  }

  /** Puts lines and dots into the scene as they are seen from this camera, and returns the texts that belong to them. */
  place(camera: PerspectiveCamera | OrthographicCamera, box: Box3, scale: number): readonly Label[] {
    this.scene.clear();
    const labels = [...this.markers.labels, ...this.rulers.labels];
    if (this.choice.box && !box.isEmpty()) {
      labels.push(...this.bounding.update(box, camera));
      this.scene.add(this.bounding.object);
    }
    this.rulers.resize(this.overlay.size.width, this.overlay.size.height);
    if (this.rulers.object.children.length > 0) this.scene.add(this.rulers.object);
    this.markers.scale = scale;
    if (this.markers.object.children.length > 0) this.scene.add(this.markers.object);
    return labels;
  }

  /** The scale bar of a picture. */
  barFor(unitsPerPixel: number, widest: number): { readonly text: string; readonly pixels: number } {
    return this.bar.in(unitsPerPixel, widest);
  }
}
