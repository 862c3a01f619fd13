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

export class Peeling {
  private targets: [WebGLRenderTarget, WebGLRenderTarget] | undefined;
  private sum: WebGLRenderTarget | undefined;
  private readonly under = new ScreenPass(
    /* glsl */ `
    uniform sampler2D layer;
    out vec4 color;
    void main() { color = texelFetch(layer, ivec2(gl_FragCoord.xy), 0); }`,
    { layer: { value: null as Texture | null } },
    { blending: CustomBlending, blendEquation: AddEquation, blendSrc: OneMinusDstAlphaFactor, blendDst: OneFactor, transparent: true },
  );

  /**
   * Draws the translucent surfaces in front of the opaque ones.
   * @param opaque its depth
   * @param draw renders the surfaces in the materials of pass `peel`
   * @returns their colours, premultiplied
   */
  render(webgl: WebGLRenderer, shared: SharedUniforms, opaque: DepthTexture, layers: number, draw: () => void): Texture {
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
      this.under.uniforms.layer.value = next.texture;
      this.under.render(webgl, sum);
      [next, before] = [before, next];
    }
    return sum.texture;
  }

  dispose(): void {
    for (const target of [...(this.targets ?? []), this.sum]) target?.dispose();
    this.targets = undefined;
    this.sum = undefined;
  }
}
