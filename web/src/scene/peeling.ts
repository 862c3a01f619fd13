/**
 * Order-independent transparency by depth peeling. Each layer draws the nearest fragments behind those of the previous layer; layers are
 * composed front to back.
 */

import {
  AddEquation,
  CustomBlending,
  DepthTexture,
  FloatType,
  NearestFilter,
  OneFactor,
  OneMinusDstAlphaFactor,
  Vector2,
  WebGLRenderTarget,
  type Texture,
  type WebGLRenderer,
} from "three";
import { ScreenPass } from "./screenPass";
import type { SharedUniforms } from "./material";

/** Number of layers: the two sides of two nested bodies need four. Fragments behind more layers are left out. */
export const LAYERS_ON_SCREEN = 8;
export const LAYERS_BY_PROCESSOR = 4;
export const LAYERS_IN_IMAGES = 16;

/** 32-bit floats, so that a stored depth equals the fragment's depth, and a layer does not draw the previous one again. */
function layerTarget(): WebGLRenderTarget {
  const depthTexture = new DepthTexture(1, 1, FloatType);
  return new WebGLRenderTarget(1, 1, { depthTexture, minFilter: NearestFilter, magFilter: NearestFilter });
}

const depthOf = (target: WebGLRenderTarget) => target.depthTexture as DepthTexture;

export class Peeling {
  private targets: [WebGLRenderTarget, WebGLRenderTarget] | undefined;
  private sum: WebGLRenderTarget | undefined;
  private readonly under = new ScreenPass(
    /* glsl */ `
    uniform sampler2D layer;
    uniform vec2 texel;
    out vec4 color;
    void main() { color = texture(layer, gl_FragCoord.xy * texel); }`,
    { layer: { value: null as Texture | null }, texel: { value: new Vector2() } },
    { blending: CustomBlending, blendEquation: AddEquation, blendSrc: OneMinusDstAlphaFactor, blendDst: OneFactor, transparent: true },
  );

  /**
   * Draws the translucent surfaces in front of the opaque ones.
   * @param opaque its depth
   * @param draw renders the surfaces in the materials of pass `peel`
   * @param between what lies between two layers, of which the depths are given; behind the last one there is no depth
   * @returns their colours, premultiplied
   */
  render(webgl: WebGLRenderer, shared: SharedUniforms, opaque: DepthTexture, layers: number, draw: () => void, between?: (from: Texture, to: Texture | undefined) => Texture): Texture {
    const { width, height } = opaque.image as { width: number; height: number };
    const targets = (this.targets ??= [layerTarget(), layerTarget()]);
    const sum = (this.sum ??= new WebGLRenderTarget(1, 1, { depthBuffer: false, minFilter: NearestFilter, magFilter: NearestFilter }));
    for (const target of [...targets, sum]) target.setSize(width, height);
    webgl.setClearColor(0x000000, 0);
    webgl.setRenderTarget(sum);
    webgl.clear(true, false, false);
    const { depth } = webgl.state.buffers;
    let [next, before] = targets;
    // Nothing is nearer than the first layer.
    depth.setClear(0);
    webgl.setRenderTarget(before);
    webgl.clear(false, true, false);
    depth.setClear(1);
    shared.opaque.value = opaque;
    for (let layer = 0; layer < layers; layer += 1) {
      shared.nearer.value = before.depthTexture;
      webgl.setRenderTarget(next);
      webgl.clear(true, true, false);
      draw();
      if (between !== undefined) this.layUnder(webgl, between(depthOf(before), depthOf(next)), sum);
      this.layUnder(webgl, next.texture, sum);
      [next, before] = [before, next];
    }
    if (between !== undefined) this.layUnder(webgl, between(depthOf(before), undefined), sum);
    return sum.texture;
  }

  private layUnder(webgl: WebGLRenderer, layer: Texture, sum: WebGLRenderTarget): void {
    this.under.uniforms.layer.value = layer;
    this.under.uniforms.texel.value.set(1 / sum.width, 1 / sum.height);
    this.under.render(webgl, sum);
  }

  dispose(): void {
    for (const target of [...(this.targets ?? []), this.sum]) target?.dispose();
    this.targets = undefined;
    this.sum = undefined;
  }
}
