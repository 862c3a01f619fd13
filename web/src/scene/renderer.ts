/**
 * Renders the surfaces: region meshes are uploaded over several frames and shown all at once. A frame is rendered only when
 * something changed. Knows nothing of protocol, server or transfer functions.
 */

import { WebGLRenderer, type Box3 } from "three";
import type { AxisName } from "../world/axes";
import { Annotations } from "./annotations";
import { SceneCamera } from "./camera";
import { prepareCanvas } from "./canvas";
import { CentreDepth } from "./centreDepth";
import { Clipping, type Clip } from "./clipping";
import { gpuDone, hasGpu } from "./gpu";
import type { RendererHandlers } from "./handlers";
import { HIDDEN_MS } from "./hiddenPlaces";
import { DEFAULT_LOOK, type Look, type SurfaceStyle } from "./look";
import type { ColorTables } from "./material";
import { Painter } from "./painter";
import { LAYERS_BY_PROCESSOR, LAYERS_ON_SCREEN } from "./peeling";
import type { Picked } from "./picking";
import { axisView, homeDirection } from "./pose";
import { AdaptiveQuality, pixelRatio, type Quality } from "./quality";
import type { RayVolume } from "./rays";
import type { RegionMesh, RegionMeshData } from "./regionMesh";
import { Slices, type Slice } from "./slices";
import { takeSnapshot, type Snapshot, type SnapshotRequest } from "./snapshot";
import { SurfaceColors } from "./surfaceColors";
import { Surfaces } from "./surfaces";
import type { SwipeTexts } from "./swipe";
import { UploadQueue } from "./uploads";
import { WhenStill } from "./whenStill";
import type { Grid, Vec3 } from "./world";

export class SurfaceRenderer {
  /** Whether a GPU renders. A processor would take twice the time for smooth edges and delay the first frame of an edit. */
  readonly onGpu = hasGpu();
  /** Pose and motion of the camera: `pose`, `restore`, `projection`. */
  readonly camera: SceneCamera;
  /** Axes cube, scale bar, bounding box, markers: `show`, `unit`, `frame`, `mark`. */
  readonly annotations: Annotations;
  /** Colours of the surfaces. */
  readonly colors: SurfaceColors;
  private readonly webgl: WebGLRenderer;
  private readonly surfaces: Surfaces;
  private readonly clipping = new Clipping();
  private readonly painter: Painter;
  private readonly slices = new Slices();
  private readonly uploads = new UploadQueue();
  /** On the GPU, not shown yet. */
  private readonly resident = new Map<number, RegionMesh>();
  /** Box around all surfaces. */
  private box: Box3;
  private currentLook = DEFAULT_LOOK;
  private frame: number | undefined;
  /** Something changed since the last frame. */
  private dirty = true;
  private frames = 0;
  private sums: ReturnType<Surfaces["levelSums"]>;
  private readonly centre: CentreDepth;
  private readonly labelsWhenStill = new WhenStill(HIDDEN_MS, async () => {
    const depths = await this.painter.depthMap(this.camera.camera);
    this.annotations.fade(this.camera.camera, depths);
  });
  private readonly quality: AdaptiveQuality;
  /** @throws when the browser has no WebGL 2 */
  constructor(
    private readonly container: HTMLElement,
    tables: ColorTables,
    private readonly handlers: RendererHandlers,
  ) {
    this.webgl = new WebGLRenderer({ antialias: this.onGpu, alpha: true, powerPreference: "high-performance" });
    this.surfaces = new Surfaces(tables);
    this.colors = new SurfaceColors(this.surfaces, () => this.invalidate());
    this.quality = new AdaptiveQuality(handlers.adaptsQuality === true, () => this.invalidate());
    this.box = this.surfaces.box;
    this.sums = this.surfaces.levelSums();
    this.painter = new Painter(this.webgl, this.surfaces, this.clipping, this.onGpu);
    this.painter.solids.add(this.slices.object);
    this.camera = new SceneCamera(this.makeCanvas(), async (x, y) => (await this.pick(x, y))?.position, () => this.invalidate());
    this.annotations = new Annotations(container, this.painter.overlay, {
      onView: (axis) => this.view(axis),
      onClip: (clip) => {
        this.setClip(clip);
        this.handlers.onClip?.(clip);
      },
      onChange: () => {
        this.boundCamera();
        this.invalidate();
      },
    });
    this.centre = new CentreDepth(this.camera, this.painter, () => this.annotations.measureAt(this.camera.camera, this.centre.depth));
    new ResizeObserver(() => this.resize()).observe(container);
    this.resize();
  }

  /** Region meshes on screen. */
  get regionCount(): number {
    return this.surfaces.count;
  }

  /** Of the picture, in pixels of the page. */
  get size(): { readonly width: number; readonly height: number } {
    return { width: this.container.clientWidth, height: this.container.clientHeight };
  }

  /** Since the page was opened. */
  get framesRendered(): number {
    return this.frames;
  }

  /** Triangles of each level that are shown or hidden by `finestLevel`, finest first, of all surfaces. */
  get levelTriangles(): readonly number[] {
    return this.sums.all;
  }

  get levelTrianglesBySurface(): readonly (readonly number[])[] {
    return this.sums.surfaces;
  }

  /** Number of geometries on the GPU, on screen or not. */
  get geometries(): number {
    return this.webgl.info.memory.geometries;
  }

  finished(): Promise<void> {
    return gpuDone(this.webgl.getContext() as WebGL2RenderingContext);
  }

  /** Queues a region mesh for upload; `onResident` follows. Takes ownership of the arrays. */
  upload(id: number, data: RegionMeshData): void {
    this.uploads.push(id, data);
    this.schedule();
  }

  /** Shows and removes region meshes between two frames. Those to show must be resident. */
  swap(show: readonly number[], remove: readonly number[]): void {
    for (const id of remove) this.surfaces.remove(id);
    for (const id of show) {
      const mesh = this.resident.get(id);
      if (mesh === undefined) throw new Error(`region mesh ${id} is not resident`);
      this.resident.delete(id);
      this.surfaces.show(id, mesh);
    }
    this.shownChanged();
  }

  /** Forgets region meshes that are not shown. */
  drop(ids: readonly number[]): void {
    for (const id of ids) {
      this.uploads.drop(id);
      this.resident.get(id)?.dispose();
      this.resident.delete(id);
    }
  }

  /** Forgets all region meshes. */
  clear(): void {
    this.uploads.clear();
    for (const mesh of this.resident.values()) mesh.dispose();
    this.resident.clear();
    this.surfaces.clear();
    this.shownChanged();
  }

  /** Sets the place of index space in the world. */
  setGrid(grid: Grid): void {
    this.uploads.uneven = this.surfaces.place(grid);
    this.annotations.frame = grid.frame;
    this.clipping.set(this.clipping.value, this.clipBounds());
    this.shownChanged();
  }

  get look(): Look {
    return this.currentLook;
  }

  /** Changes some of the look. */
  setLook(change: Partial<Look>): void {
    this.currentLook = { ...this.currentLook, ...change };
    this.surfaces.setLook(this.currentLook);
    this.invalidate();
  }

  /** Visibility, opacity and colour of a surface. */
  setSurfaceStyle(surface: number, change: Partial<SurfaceStyle>): void {
    const materials = this.surfaces.of(surface);
    materials.style = { ...materials.style, ...change };
    this.invalidate();
  }

  /** How many times higher the world is shown than it is. */
  set exaggeration(factor: number) {
    this.camera.exaggeration = factor;
    this.surfaces.shared.normalScale.value.set(1, 1, factor ** -2);
    this.annotations.exaggeration = factor;
  }

  setEdgeColor(color: string): void {
    this.surfaces.edgeColor = color;
    this.invalidate();
  }

  /** Shows only triangles of this level and coarser ones. */
  setFinestLevel(level: number): void {
    this.surfaces.finestLevel = level;
    this.invalidate();
  }

  /** What is cut away, in world units. */
  setClip(clip: Clip): void {
    this.clipping.set(clip, this.clipBounds());
    this.surfaces.clippingPlanes = this.clipping.count;
    this.invalidate();
  }

  /** Slices through the volume, and none besides. */
  setSlices(slices: readonly Slice[]): void {
    this.slices.set(slices);
    this.boundCamera();
    this.invalidate();
  }

  /** Sets the volume that is drawn along the rays of the picture, or redraws it after a change. `undefined`: none. */
  setVolume(volume: RayVolume | undefined): void {
    this.painter.volume = volume;
    this.boundCamera();
    this.invalidate();
  }

  /**
   * A value of each vertex of a region mesh on screen, in the order of its chunk, for colour mode `value`. Meshes without values are grey.
   * @throws when there are not as many as vertices
   */
  setValues(id: number, values: Float32Array<ArrayBuffer>): void {
    this.surfaces.get(id)?.setValues(values);
    this.invalidate();
  }

  /**
   * Compares what is shown now with what follows: `keep` it, then `swipe` to a share of the width, left of which it stays. Its meshes
   * stay in the GPU's memory until `release`.
   */
  keep(): void {
    this.surfaces.keep();
  }

  release(): void {
    this.surfaces.release();
    this.boundCamera();
    this.swipe(undefined);
  }

  swipe(share: number | undefined, texts?: SwipeTexts): void {
    this.annotations.swipe.show(this.surfaces.hasKept ? share : undefined, texts);
    this.invalidate();
  }

  /**
   * The nearest point of a surface at a place of the page (`clientX`, `clientY`); `undefined` if there is none.
   * @param through to this surface: translucent ones before it are looked through
   */
  pick(clientX: number, clientY: number, through?: number): Promise<Picked | undefined> {
    const { left, top, width, height } = this.webgl.domElement.getBoundingClientRect();
    const [x, y] = [(clientX - left) / width, (clientY - top) / height];
    if (!(x >= 0 && x < 1 && y >= 0 && y < 1)) return Promise.resolve(undefined);
    const side = x < (this.annotations.swipe.value ?? 0) ? "kept" : "now";
    return this.painter.pick(this.camera.camera, x, y, side, through);
  }

  /**
   * The picture as pixels, without what the page lays over it; `image.ts` composes it with colour bar, scale bar and caption.
   * @throws if the graphics device cannot render the requested number of pixels
   */
  snapshot(request: SnapshotRequest): Snapshot {
    const { webgl, painter, camera, annotations, surfaces, size } = this;
    this.invalidate();
    return takeSnapshot({ webgl, painter, camera, annotations, surfaces, look: this.currentLook, size, swipe: annotations.swipe.value }, request);
  }

  /** Bounds within which clip planes and slices make sense: of the volume in the world, or of the surfaces until the grid is known. */
  get bounds(): { readonly min: Vec3; readonly max: Vec3 } {
    const { min, max } = this.clipBounds();
    return { min: min.toArray(), max: max.toArray() };
  }

  get clip(): Clip {
    return this.clipping.value;
  }

  /** Moves the camera until the surface fills the view; see `SceneCamera.fit`. */
  fit(back?: Vec3, animate = true): void {
    if (this.box.isEmpty()) return;
    this.camera.fit(this.box, this.surfaces.points(), back, animate);
  }

  /** As a page just opened shows the surface. */
  home(animate = true): void {
    this.fit(homeDirection(this.annotations.frame), animate);
  }

  /** Along an axis of the world. */
  view(axis: AxisName, animate = true): void {
    this.fit(axisView(axis, this.annotations.frame), animate);
  }

  private makeCanvas(): HTMLCanvasElement {
    const lost = () => {
      this.clear();
      this.handlers.onContextLost();
    };
    this.container.append(this.webgl.domElement);
    return prepareCanvas(this.webgl.domElement, { lost, restored: () => this.handlers.onContextRestored() });
  }

  private clipBounds(): Box3 {
    const { volumeBox } = this.surfaces;
    return volumeBox.isEmpty() ? this.box : volumeBox;
  }

  /** If nothing else is drawn, the camera's depths are those of the surfaces alone, for the depth buffer's precision. */
  private boundCamera(): void {
    const more = this.annotations.fillsVolume || this.slices.object.children.length > 0 || this.painter.volume !== undefined;
    const around = this.surfaces.keptBox;
    this.camera.bound(this.box, more ? around.union(this.clipBounds()) : around);
  }

  private shownChanged(): void {
    this.sums = this.surfaces.levelSums();
    this.box = this.surfaces.box;
    this.boundCamera();
    this.invalidate();
  }

  private invalidate(): void {
    this.dirty = true;
    this.schedule();
  }

  private schedule(): void {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.step();
    });
  }

  private step(): void {
    const uploaded = this.uploads.uploadSome(this.webgl, this.camera.camera);
    for (const [id, mesh] of uploaded) this.resident.set(id, mesh);
    for (const [id] of uploaded) this.handlers.onResident(id);
    const quality = this.quality.next(this.camera.advance());
    if (this.dirty) {
      this.dirty = false;
      this.paint(quality);
      this.frames += 1;
      this.handlers.onFrame();
    }
    if (!this.uploads.empty) this.schedule();
  }

  private paint(quality: Quality): void {
    const ratio = quality.pixels * pixelRatio();
    if (ratio !== this.webgl.getPixelRatio()) this.webgl.setPixelRatio(ratio);
    const { camera, annotations } = this;
    const { width, height } = this.webgl.domElement;
    annotations.update(camera.camera, this.clipBounds(), this.clipping.value, this.centre.depth);
    this.centre.lookSoon(annotations.value.scale);
    this.labelsWhenStill.lookSoon(annotations.hasPlaces);
    this.painter.paint({
      target: null,
      width,
      height,
      camera: camera.camera,
      look: this.currentLook,
      effects: this.onGpu && quality.effects,
      layers: Math.ceil(quality.layers * (this.onGpu ? LAYERS_ON_SCREEN : LAYERS_BY_PROCESSOR)),
      scale: this.webgl.getPixelRatio(),
      swipe: annotations.swipe.value,
      radius: camera.radius,
      // A cloud has no edges that fewer pixels would show.
      fineness: this.onGpu && quality.effects ? 1 : 0.5,
    });
  }

  private resize(): void {
    const { width, height } = this.size;
    if (width === 0 || height === 0) return;
    this.webgl.setSize(width, height);
    this.camera.aspect = width / height;
    this.annotations.resize(width, height);
    this.dirty = true;
    // At once: a resized canvas is blank until a frame is rendered.
    if (this.frame !== undefined) cancelAnimationFrame(this.frame);
    this.frame = undefined;
    this.step();
  }
}
