/**
 * Paints a frame, on screen or into an image. If there are only opaque surfaces, they are rendered directly into the target; effects,
 * translucent surfaces and caps need an intermediate picture with its depth.
 */

import {
  DepthStencilFormat,
  DepthTexture,
  NearestFilter,
  Scene,
  UnsignedInt248Type,
  Vector4,
  WebGLRenderTarget,
  type OrthographicCamera,
  type PerspectiveCamera,
  type Texture,
  type WebGLRenderer,
} from "three";
import type { Clipping } from "./clipping";
import { Effects } from "./effects";
import { SHADINGS, type Look } from "./look";
import { Peeling } from "./peeling";
import { Picking, type Picked } from "./picking";
import type { RayVolume } from "./rays";
import type { MiddleDepths } from "./scale";
import type { Side, Surfaces } from "./surfaces";

/** Half the width of isolines, pixels of the page. */
const ISOLINE = 0.6;
/** Samples for each pixel of the intermediate picture, if a GPU renders. */
const SAMPLES = 4;

export interface FrameRequest {
  /** `null`: the screen. */
  readonly target: WebGLRenderTarget | null;
  /** Pixels. */
  readonly width: number;
  readonly height: number;
  readonly camera: PerspectiveCamera | OrthographicCamera;
  readonly look: Look;
  /** Ambient occlusion and silhouettes, if the look has them. */
  readonly effects: boolean;
  /** Layers of translucent surfaces. */
  readonly layers: number;
  /** Pixels for one on the page. */
  readonly scale: number;
  /** Share of the width, from the left, that shows the kept picture; `undefined`: nothing is compared. */
  readonly swipe: number | undefined;
  /** Radius of what is shown. */
  readonly radius: number;
  /** Pixels of a volume for one of the picture, along each side. */
  readonly fineness: number;
}

export class Painter {
  /** Objects that are rendered with the surfaces: slices, caps. */
  readonly solids = new Scene();
  /** Objects that are rendered over the picture and hidden by surfaces in front of them: lines, markers. */
  readonly overlay = new Scene();
  /** What is drawn along the rays, up to the surfaces. */
  volume: RayVolume | undefined;
  private readonly surfaceScene = new Scene();
  private between: WebGLRenderTarget | undefined;
  private normals: WebGLRenderTarget | undefined;
  private readonly peeling = new Peeling();
  private readonly effects = new Effects();
  private readonly picking = new Picking();

  constructor(
    private readonly webgl: WebGLRenderer,
    private readonly surfaces: Surfaces,
    private readonly clipping: Clipping,
    private readonly multisample: boolean,
  ) {
    webgl.autoClear = false;
    this.surfaceScene.add(surfaces.root);
    this.solids.add(clipping.object);
  }

  paint(request: FrameRequest): void {
    const { webgl } = this;
    const { swipe, width, height } = request;
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(request.camera);
    this.surfaces.shared.isolineWidth.value = ISOLINE * request.scale;
    if (swipe === undefined) {
      this.paintSide("now", request);
      return;
    }
    const border = Math.round(swipe * width);
    for (const [side, from, to] of [["kept", 0, border], ["now", border, width]] as const) {
      this.scissor(request, new Vector4(from, 0, to - from, height));
      if (to > from) this.paintSide(side, request);
    }
    this.scissor(request, undefined);
    webgl.setRenderTarget(null);
  }

  /** The surface under a pixel; see `Picking.pick`. */
  pick(camera: PerspectiveCamera | OrthographicCamera, x: number, y: number, side: Side, through?: number): Promise<Picked | undefined> {
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(camera);
    return this.picking.pick(this.webgl, camera, x, y, (eye) => {
      const translucent = this.surfaces.visible(false).filter((surface) => through === undefined || surface === through);
      this.drawPlaces([...this.surfaces.visible(true), ...translucent], side, eye);
    });
  }

  /** Depths of surfaces in the middle third of the picture. */
  depths(camera: PerspectiveCamera | OrthographicCamera): Promise<MiddleDepths> {
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(camera);
    return this.picking.depths(this.webgl, camera, (eye) => this.drawAllPlaces(eye));
  }

  /** The same, at once: for images. */
  depthsNow(camera: PerspectiveCamera | OrthographicCamera): MiddleDepths {
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(camera);
    return this.picking.depthsNow(this.webgl, camera, (eye) => this.drawAllPlaces(eye));
  }

  /** Depths of surfaces over the whole picture; see `Picking.map`. */
  depthMap(camera: PerspectiveCamera | OrthographicCamera): Promise<number[]> {
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(camera);
    return this.picking.map(this.webgl, camera, (eye) => this.drawAllPlaces(eye));
  }

  /** The same, at once: for images. */
  depthMapNow(camera: PerspectiveCamera | OrthographicCamera): number[] {
    this.surfaces.shared.clipPlanes.value = this.clipping.inView(camera);
    return this.picking.mapNow(this.webgl, camera, (eye) => this.drawAllPlaces(eye));
  }

  private drawAllPlaces(eye: PerspectiveCamera | OrthographicCamera): void {
    this.drawPlaces([...this.surfaces.visible(true), ...this.surfaces.visible(false)], "now", eye);
  }

  private drawPlaces(surfaces: readonly number[], side: Side, eye: PerspectiveCamera | OrthographicCamera): void {
    this.surfaces.prepare("pick", surfaces, side);
    this.webgl.render(this.surfaceScene, eye);
  }

  /** Frees the targets that only images and effects need; they are made again when needed. */
  releaseTargets(): void {
    this.between?.dispose();
    this.between?.depthTexture?.dispose();
    this.between = undefined;
    this.normals?.dispose();
    this.normals = undefined;
    this.peeling.dispose();
    this.volume?.releaseTargets();
    this.effects.dispose();
  }

  private paintSide(side: Side, request: FrameRequest): void {
    const { look } = request;
    if (!this.clipping.caps) this.clipping.hideCaps();
    const translucent = this.surfaces.visible(false);
    const effects = request.effects && (look.occlusion || look.silhouettes);
    if (translucent.length > 0 || effects || this.clipping.caps || this.volume !== undefined) this.paintInSteps(side, translucent, request);
    else {
      this.begin(request);
      this.paintOpaque(side, request);
    }
    if (this.overlay.children.length > 0) this.webgl.render(this.overlay, request.camera);
  }

  /** Clears the target to the background. */
  private begin({ target, look }: FrameRequest): void {
    const { webgl } = this;
    webgl.setRenderTarget(target);
    const solid = look.background === "black" || look.background === "white";
    webgl.setClearColor(look.background === "white" ? 0xffffff : 0x000000, solid ? 1 : 0);
    webgl.clear();
  }

  private paintOpaque(side: Side, { camera }: FrameRequest): void {
    this.surfaces.prepare("opaque", this.surfaces.visible(true), side);
    this.webgl.render(this.surfaceScene, camera);
    if (this.hasSolids) this.webgl.render(this.solids, camera);
  }

  private get hasSolids(): boolean {
    return this.solids.children.some(({ children, visible }) => visible && children.length > 0);
  }

  private paintNormals(side: Side, { camera, width, height }: FrameRequest): Texture {
    const { webgl } = this;
    const normals = (this.normals ??= new WebGLRenderTarget(1, 1, { minFilter: NearestFilter, magFilter: NearestFilter }));
    normals.setSize(width, height);
    webgl.setRenderTarget(normals);
    webgl.setClearColor(0x000000, 0);
    webgl.clear();
    this.surfaces.prepare("normal", this.surfaces.visible(true), side);
    webgl.render(this.surfaceScene, camera);
    return normals.texture;
  }

  private paintInSteps(side: Side, translucent: readonly number[], request: FrameRequest): void {
    const { webgl } = this;
    const { camera, look, width, height } = request;
    const between = (this.between ??= this.makeBetween());
    between.setSize(width, height);
    this.begin({ ...request, target: between });
    if (this.clipping.caps) this.markInsides(side, request);
    this.paintOpaque(side, request);
    const depth = between.depthTexture as DepthTexture;
    const isBetween = translucent.length > 0 && this.volume?.isBetweenLayers === true;
    const layers = translucent.length > 0 ? this.paintLayers(side, translucent, request, depth, isBetween) : undefined;
    const volume = isBetween ? undefined : this.paintVolume(request, depth);
    const { effects, target, scale, radius } = request;
    // Normals from depths alone are those of the triangles, which would be visible in an image.
    const normals = effects && look.occlusion && target !== null && !this.hasSolids ? this.paintNormals(side, request) : undefined;
    this.effects.resolve(webgl, {
      normals,
      picture: between.texture,
      depth,
      layers,
      volume,
      occlusion: effects && look.occlusion,
      silhouettes: effects && look.silhouettes,
      scale,
      radius,
      camera,
      target,
    });
  }

  /** @param isBetween the volume is between the layers */
  private paintLayers(side: Side, translucent: readonly number[], request: FrameRequest, depth: DepthTexture, isBetween: boolean): Texture {
    const { webgl, surfaces } = this;
    const draw = () => {
      surfaces.prepare("peel", translucent, side);
      webgl.render(this.surfaceScene, request.camera);
    };
    const between = (from: Texture, to: Texture | undefined) => this.paintVolume(request, depth, from, to) as Texture;
    return this.peeling.render(webgl, surfaces.shared, depth, request.layers, draw, isBetween ? between : undefined);
  }

  private paintVolume({ camera, width, height, fineness }: FrameRequest, opaque: DepthTexture, from?: Texture, to?: Texture): Texture | undefined {
    return this.volume?.render(this.webgl, { camera, clipPlanes: this.surfaces.shared.clipPlanes.value, opaque, from, to, width, height, fineness });
  }

  /**
   * Marks the pixels at which a solid is cut open: if the first layer of its surface behind the cut shows its inside, its bit in the
   * stencil buffer is set there. If only parity counted, a surface that is open at the volume's border would invert the caps of everything
   * in front of it. That first layer may lie at a place that another plane has cut away, so only planes that face the camera cut here.
   */
  private markInsides(side: Side, { camera, look }: FrameRequest): void {
    const { webgl, surfaces, clipping } = this;
    const { clipPlanes } = surfaces.shared;
    const all = clipPlanes.value;
    clipPlanes.value = clipping.inView(camera, true);
    const opaque = surfaces.visible(true);
    for (const surface of opaque) {
      for (const pass of ["outside", "inside"] as const) {
        surfaces.prepare(pass, [surface], side);
        webgl.render(this.surfaceScene, camera);
      }
      webgl.clear(false, true, false);
    }
    clipPlanes.value = all;
    const colored = opaque.map((surface) => ({ surface, color: surfaces.style(surface).color ?? SHADINGS[look.material].color }));
    clipping.showCaps(colored, camera);
  }

  private makeBetween(): WebGLRenderTarget {
    const depthTexture = new DepthTexture(1, 1, UnsignedInt248Type);
    depthTexture.format = DepthStencilFormat;
    return new WebGLRenderTarget(1, 1, { depthTexture, stencilBuffer: true, samples: this.multisample ? SAMPLES : 0 });
  }

  private scissor({ target, width, height }: FrameRequest, box: Vector4 | undefined): void {
    const { webgl } = this;
    if (target !== null) {
      target.scissorTest = box !== undefined;
      target.scissor.copy(box ?? target.viewport);
      return;
    }
    webgl.setScissorTest(box !== undefined);
    const ratio = webgl.getPixelRatio();
    if (box !== undefined) webgl.setScissor(box.divideScalar(ratio));
    else webgl.setScissor(0, 0, width / ratio, height / ratio);
  }
}
