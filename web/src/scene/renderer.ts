/**
 * Renders the surface: region meshes are uploaded over several frames and shown all at once. A frame is rendered only when
 * something changed. Knows nothing of protocol, server or transfer functions.
 */

import { Box3, Group, Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { OrbitCamera } from "./camera";
import { hasGpu } from "./gpu";
import { SurfaceMaterials, type ColorMode, type ColorTables } from "./material";
import type { RegionMesh, RegionMeshData } from "./regionMesh";
import { UploadQueue } from "./uploads";
import { corners, worldFromGrid, worldFromIndex, type Grid } from "./world";

/** Pause between two queries whether the GPU is done. */
const FENCE_POLL_MS = 3;

export interface RendererHandlers {
  /** A region mesh is on the GPU and can be shown. */
  readonly onResident: (id: number) => void;
  /** A frame was rendered. */
  readonly onFrame: () => void;
  /** The GPU lost its memory; all region meshes are gone and have to be uploaded again. */
  readonly onContextLost: () => void;
  readonly onContextRestored: () => void;
}

export class SurfaceRenderer {
  /**
   * Frames are rendered by a GPU, not by a processor, which would take twice the time for smooth edges and delay the first
   * frame of an edit.
   */
  readonly onGpu = hasGpu();
  private readonly webgl: WebGLRenderer;
  private readonly scene = new Scene();
  /** Its matrix is the world from index space; its children are the region meshes on screen. */
  private readonly root = new Group();
  private readonly camera: OrbitCamera;
  private readonly materials: SurfaceMaterials;
  private readonly uploads = new UploadQueue();
  /** On the GPU, not shown yet. */
  private readonly resident = new Map<number, RegionMesh>();
  private readonly shown = new Map<number, RegionMesh>();
  /** Around all that is shown. */
  private readonly sphere = new Sphere(new Vector3(), 1);
  private frame: number | undefined;
  /** Something changed since the last frame. */
  private dirty = true;
  private mode: ColorMode = "transfer";
  private finestLevel = 0;
  private wireframe = false;
  private frames = 0;
  private levelSums: readonly number[] = [0, 0, 0, 0, 0, 0];

  /** @throws when the browser has no WebGL 2 */
  constructor(
    private readonly container: HTMLElement,
    tables: ColorTables,
    private readonly handlers: RendererHandlers,
  ) {
    this.webgl = new WebGLRenderer({ antialias: this.onGpu, alpha: true, powerPreference: "high-performance" });
    this.webgl.setClearColor(0x000000, 0);
    this.materials = new SurfaceMaterials(tables);
    this.root.matrixAutoUpdate = false;
    this.scene.add(this.root);
    const canvas = this.webgl.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "Surface: drag to orbit, right-drag to pan, wheel to zoom, F to fit");
    container.append(canvas);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.clear();
      this.handlers.onContextLost();
    });
    canvas.addEventListener("webglcontextrestored", () => this.handlers.onContextRestored());
    this.camera = new OrbitCamera(canvas, () => this.invalidate());
    new ResizeObserver(() => this.resize()).observe(container);
    this.resize();
  }

  /** Region meshes on screen. */
  get regionCount(): number {
    return this.shown.size;
  }

  /** Frames rendered since the page was opened. */
  get framesRendered(): number {
    return this.frames;
  }

  /** Triangles of each level that are shown or hidden by `finestLevel`, finest first. */
  get levelTriangles(): readonly number[] {
    return this.levelSums;
  }

  get pose(): OrbitCamera["pose"] {
    return this.camera.pose;
  }

  /** Waits until the GPU has rendered all frames so far. */
  async finished(): Promise<void> {
    const gl = this.webgl.getContext() as WebGL2RenderingContext;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    if (fence === null) return;
    do await new Promise((resolve) => setTimeout(resolve, FENCE_POLL_MS));
    while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED);
    gl.deleteSync(fence);
  }

  /** Queues a region mesh for upload; `onResident` follows. Takes ownership of the arrays. */
  upload(id: number, data: RegionMeshData): void {
    this.uploads.push(id, data);
    this.schedule();
  }

  /** Shows and removes region meshes between two frames. Those to show must be resident. */
  swap(show: readonly number[], remove: readonly number[]): void {
    for (const id of remove) {
      this.shown.get(id)?.dispose();
      this.shown.delete(id);
    }
    for (const id of show) {
      const mesh = this.resident.get(id);
      if (mesh === undefined) throw new Error(`region mesh ${id} is not resident`);
      this.resident.delete(id);
      this.shown.set(id, mesh);
      mesh.object.frustumCulled = true;
      this.applyDisplay(mesh);
      this.root.add(mesh.object);
    }
    this.updateSums();
    this.invalidate();
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
    for (const meshes of [this.resident, this.shown]) {
      for (const mesh of meshes.values()) mesh.dispose();
      meshes.clear();
    }
    this.updateSums();
    this.invalidate();
  }

  /** Where index space lies in the world. */
  setGrid(grid: Grid): void {
    this.root.matrix.copy(worldFromIndex(grid));
    this.root.matrixWorldNeedsUpdate = true;
    this.materials.worldFromGrid = worldFromGrid(grid);
    this.updateSphere();
    this.invalidate();
  }

  setColorMode(mode: ColorMode): void {
    this.mode = mode;
    this.materials.mode = mode;
    this.applyDisplayToAll();
  }

  setAlpha(alpha: number): void {
    // Set after every edit; where α is the same, the frame would be too.
    if (this.materials.alpha === alpha) return;
    this.materials.alpha = alpha;
    this.invalidate();
  }

  /** RGBA bytes over the blended feature. */
  setTransfer(table: Uint8Array<ArrayBuffer>): void {
    this.materials.transfer = table;
    this.invalidate();
  }

  setWireframe(on: boolean): void {
    this.wireframe = on;
    this.applyDisplayToAll();
  }

  setEdgeColor(color: string): void {
    this.materials.edges = color;
    this.invalidate();
  }

  /** Shows only triangles of this level and coarser ones. */
  setFinestLevel(level: number): void {
    this.finestLevel = level;
    this.applyDisplayToAll();
  }

  /** Moves the camera back until the surface fills the view; see `OrbitCamera.fit`. */
  fit(fromFirstDirection: boolean): void {
    const box = this.worldBounds();
    if (box.isEmpty()) return;
    // The regions' own boxes lie closer to a round surface than the box around all.
    const points = [...this.shown.values()].flatMap((mesh) => corners(mesh.bounds, this.root.matrix));
    this.camera.fit(box, points, fromFirstDirection);
    this.invalidate();
  }

  private applyDisplayToAll(): void {
    for (const mesh of this.shown.values()) this.applyDisplay(mesh);
    this.invalidate();
  }

  private applyDisplay(mesh: RegionMesh): void {
    mesh.material = this.mode === "level" ? this.materials.levels : this.materials.whole;
    mesh.finestLevel = this.finestLevel;
    mesh.setWire(this.wireframe ? this.materials.wire : undefined);
  }

  private worldBounds(): Box3 {
    const box = new Box3();
    for (const { bounds } of this.shown.values()) {
      for (const corner of corners(bounds, this.root.matrix)) box.expandByPoint(corner);
    }
    return box;
  }

  private updateSums(): void {
    const sums = [0, 0, 0, 0, 0, 0];
    for (const mesh of this.shown.values()) {
      mesh.levelTriangles.forEach((n, level) => (sums[level] = (sums[level] ?? 0) + n));
    }
    this.levelSums = sums;
    this.updateSphere();
  }

  private updateSphere(): void {
    const box = this.worldBounds();
    if (!box.isEmpty()) box.getBoundingSphere(this.sphere);
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
    this.camera.advance();
    if (this.dirty) {
      this.dirty = false;
      this.camera.clipTo(this.sphere);
      this.webgl.render(this.scene, this.camera.camera);
      this.frames += 1;
      this.handlers.onFrame();
    }
    if (!this.uploads.empty) this.schedule();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0) return;
    this.webgl.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.webgl.setSize(width, height);
    this.camera.aspect = width / height;
    this.dirty = true;
    // At once: a resized canvas is blank until a frame is rendered.
    if (this.frame !== undefined) cancelAnimationFrame(this.frame);
    this.frame = undefined;
    this.step();
  }
}
