/**
 * The picture: a camera, and pieces of a surface that are uploaded little by little and shown all at once.
 * Draws only when something changed. Knows nothing of protocols, servers or transfer functions.
 */

import {
  Box3,
  Group,
  PerspectiveCamera,
  RawShaderMaterial,
  GLSL3,
  Scene,
  Sphere,
  Vector3,
  WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { SurfaceMaterials, type ColorMode, type ColorTables } from "./material";
import { RegionMesh, type RegionMeshData } from "./regionMesh";
import { corners, fitDistance, worldFromGrid, worldFromIndex, type Grid } from "./world";

/** Bytes handed to the GPU in one frame: 16 MB take a millisecond or two, so a turning picture keeps turning. */
const UPLOAD_BYTES_PER_FRAME = 16 << 20;
const FOV_DEGREES = 32;
const DAMPING = 0.12;
/** How often it is asked whether a picture is drawn. */
const FENCE_MS = 3;
/** After so many steps a millionth of a glide is left. */
const REST_STEPS = Math.ceil(Math.log(1e-6) / Math.log(1 - DAMPING));
/** From the front, left and above, for volumes whose world is right, anterior, superior. */
const FIRST_DIRECTION = new Vector3(-0.72, 0.58, 0.38).normalize();

export interface RendererHandlers {
  /** A piece is on the GPU and can be shown. */
  readonly onResident: (id: number) => void;
  /** A frame was drawn. */
  readonly onDrawn: () => void;
  /** The GPU forgot everything; all pieces are gone and have to be uploaded again. */
  readonly onContextLost: () => void;
  readonly onContextRestored: () => void;
}

export class SurfaceRenderer {
  /** Pictures are drawn by a GPU, not by a processor. */
  readonly onGpu = hasGpu();
  private readonly webgl: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly root = new Group();
  private readonly camera = new PerspectiveCamera(FOV_DEGREES, 1, 0.1, 10);
  private readonly controls: OrbitControls;
  private readonly materials: SurfaceMaterials;
  private readonly shown = new Map<number, RegionMesh>();
  /** On the GPU, not shown yet. */
  private readonly ready = new Map<number, RegionMesh>();
  /** Still to be uploaded, in order. As many as its owner hands over. */
  private readonly queue = new Map<number, RegionMesh>();
  private readonly staging = new Scene();
  private readonly stagingTarget = new WebGLRenderTarget(1, 1);
  private readonly stagingMaterial = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: "in vec3 position; void main() { gl_Position = vec4(position, 1.0); }",
    fragmentShader: "precision mediump float; out vec4 color; void main() { color = vec4(0.0); }",
  });
  private readonly sphere = new Sphere(new Vector3(), 1);
  private frame: number | undefined;
  private dirty = true;
  private mode: ColorMode = "transfer";
  private finestLevel = 0;
  private wireframe = false;
  private drawn = 0;
  private gliding = false;
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
    this.camera.up.set(0, 0, 1);
    this.camera.position.copy(FIRST_DIRECTION).multiplyScalar(4);

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

    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = DAMPING;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => this.invalidate());
    this.controls.addEventListener("start", () => this.invalidate());
    new ResizeObserver(() => this.resize()).observe(container);
    this.resize();
  }

  /** Pieces shown. */
  get regionCount(): number {
    return this.shown.size;
  }

  /** Frames drawn since the page was opened. */
  get framesDrawn(): number {
    return this.drawn;
  }

  /** Triangles of each level that are shown or hidden by `finestLevel`, finest first. */
  get levelTriangles(): readonly number[] {
    return this.levelSums;
  }

  /** Where the camera stands and looks, in world units. */
  get pose(): { readonly position: readonly number[]; readonly target: readonly number[] } {
    return { position: this.camera.position.toArray(), target: this.controls.target.toArray() };
  }

  /** Waits until all that was asked for so far is drawn. */
  async finished(): Promise<void> {
    const gl = this.webgl.getContext() as WebGL2RenderingContext;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    if (fence === null) return;
    do await new Promise((resolve) => setTimeout(resolve, FENCE_MS));
    while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED);
    gl.deleteSync(fence);
  }

  /** Queues a piece for upload; `onResident` follows. Takes the arrays over. */
  upload(id: number, data: RegionMeshData): void {
    const mesh = new RegionMesh(data, this.stagingMaterial);
    mesh.hideAll();
    // Rendered once, unseen, to be uploaded: wherever it lies.
    mesh.object.frustumCulled = false;
    this.queue.set(id, mesh);
    this.schedule();
  }

  /** Shows and removes pieces in one step, so no frame is drawn in between. Pieces to show must be resident. */
  swap(show: readonly number[], remove: readonly number[]): void {
    for (const id of remove) {
      this.shown.get(id)?.dispose();
      this.shown.delete(id);
    }
    for (const id of show) {
      const mesh = this.ready.get(id);
      if (mesh === undefined) throw new Error(`piece ${id} is not resident`);
      this.ready.delete(id);
      this.shown.set(id, mesh);
      mesh.object.frustumCulled = true;
      this.dress(mesh);
      this.root.add(mesh.object);
    }
    this.updateSums();
    this.invalidate();
  }

  /** Forgets pieces that are not shown. */
  drop(ids: readonly number[]): void {
    for (const id of ids) {
      (this.queue.get(id) ?? this.ready.get(id))?.dispose();
      this.queue.delete(id);
      this.ready.delete(id);
    }
  }

  /** Forgets all pieces. */
  clear(): void {
    for (const pieces of [this.queue, this.ready, this.shown]) {
      for (const mesh of pieces.values()) mesh.dispose();
      pieces.clear();
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
    for (const mesh of this.shown.values()) this.dress(mesh);
    this.invalidate();
  }

  setAlpha(alpha: number): void {
    // Told after every edit; the picture before it is not worth drawing again.
    if (this.materials.alpha === alpha) return;
    this.materials.alpha = alpha;
    this.invalidate();
  }

  /** RGBA bytes over the blended feature. */
  setTransfer(lut: Uint8Array<ArrayBuffer>): void {
    this.materials.transfer = lut;
    this.invalidate();
  }

  setWireframe(on: boolean): void {
    this.wireframe = on;
    for (const mesh of this.shown.values()) this.dress(mesh);
    this.invalidate();
  }

  setEdgeColor(color: string): void {
    this.materials.edges = color;
    this.invalidate();
  }

  /** Shows only triangles of this level and coarser ones. */
  setFinestLevel(level: number): void {
    this.finestLevel = level;
    for (const mesh of this.shown.values()) this.dress(mesh);
    this.invalidate();
  }

  /** Moves the camera back until the surface fills the view; `fresh` looks from the first direction again. */
  fit(fresh = false): void {
    const box = this.worldBounds();
    if (box.isEmpty()) return;
    const back = fresh
      ? FIRST_DIRECTION.clone()
      : this.camera.position.clone().sub(this.controls.target).normalize();
    const center = box.getCenter(this.controls.target);
    // The pieces' own boxes lie closer to a round surface than the box around all.
    const points = [...this.shown.values()].flatMap((mesh) => corners(mesh.bounds, this.root.matrix));
    const fov = (FOV_DEGREES * Math.PI) / 180;
    const distance = fitDistance(points, center, back, this.camera.up, fov, this.camera.aspect);
    this.camera.position.copy(this.controls.target).addScaledVector(back, 1.04 * distance);
    this.controls.update();
    this.invalidate();
  }

  dispose(): void {
    if (this.frame !== undefined) cancelAnimationFrame(this.frame);
    this.clear();
    this.controls.dispose();
    this.materials.dispose();
    this.stagingMaterial.dispose();
    this.stagingTarget.dispose();
    this.webgl.dispose();
  }

  private dress(mesh: RegionMesh): void {
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
    this.uploadSome();
    // Damping: the camera glides on, and its `change` event asks for the next frame.
    if (this.controls.update()) {
      this.gliding = true;
    } else if (this.gliding) {
      // What is left of the glide is too little to see; used up now, or the camera would creep at the next picture.
      this.gliding = false;
      for (let i = 0; i < REST_STEPS; i += 1) this.controls.update();
    }
    if (this.dirty) {
      this.dirty = false;
      const { center, radius } = this.sphere;
      const distance = this.camera.position.distanceTo(center);
      this.camera.far = distance + 1.01 * radius;
      this.camera.near = Math.max(distance - 1.01 * radius, this.camera.far / 2000);
      this.camera.updateProjectionMatrix();
      this.webgl.render(this.scene, this.camera);
      this.drawn += 1;
      this.handlers.onDrawn();
    }
    if (this.queue.size > 0) this.schedule();
  }

  /** Renders queued pieces into a single pixel nobody sees: that is what makes three.js hand them to the GPU. */
  private uploadSome(): void {
    const batch: [number, RegionMesh][] = [];
    let bytes = 0;
    for (const [id, mesh] of this.queue) {
      if (bytes > 0 && bytes + mesh.bytes > UPLOAD_BYTES_PER_FRAME) break;
      bytes += mesh.bytes;
      batch.push([id, mesh]);
    }
    if (batch.length === 0) return;
    this.staging.add(...batch.map(([, mesh]) => mesh.object));
    this.webgl.setRenderTarget(this.stagingTarget);
    this.webgl.render(this.staging, this.camera);
    this.webgl.setRenderTarget(null);
    this.staging.clear();
    for (const [id, mesh] of batch) {
      this.queue.delete(id);
      this.ready.set(id, mesh);
    }
    for (const [id] of batch) this.handlers.onResident(id);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0) return;
    this.webgl.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.webgl.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
    // At once: a resized canvas is blank until it is drawn.
    if (this.frame !== undefined) cancelAnimationFrame(this.frame);
    this.frame = undefined;
    this.step();
  }
}

/** Whether pictures are drawn by a GPU. A processor takes twice the time for smooth edges, and the first picture is late. */
function hasGpu(): boolean {
  const probe = document.createElement("canvas").getContext("webgl2");
  if (probe === null) return false;
  // Some browsers tell the name only here. None tells by `failIfMajorPerformanceCaveat` where SwiftShader was asked for.
  const unmasked = probe.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL;
  const name = String(probe.getParameter(unmasked ?? probe.RENDERER));
  // Browsers keep few contexts.
  probe.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}
