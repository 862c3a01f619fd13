/** A material of one colour, for objects besides the surface. It writes sRGB as the surface's materials do, on screen and in images alike. */

import { Color, GLSL3, LessEqualDepth, ShaderMaterial, SRGBColorSpace } from "three";

/** The red, green and blue of a style, as they are: not converted to linear light. */
export function srgb(style: string): Color {
  const { r, g, b } = new Color(style).getRGB({ r: 0, g: 0, b: 0 }, SRGBColorSpace);
  return new Color().setRGB(r, g, b);
}

export class PlainMaterial extends ShaderMaterial {
  private readonly plain: { value: Color };
  private readonly size = { value: 1 };
  private readonly pixels: number;
  private readonly forward = { value: 0 };

  /** @param pixels if points are drawn: discs of this diameter in pixels */
  constructor(style: string, opacity = 1, pixels = 0) {
    super({
      glslVersion: GLSL3,
      vertexShader: /* glsl */ `
        uniform float size;
        uniform float forward;
        void main() {
          gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
          gl_Position.z -= forward * gl_Position.w;
          gl_PointSize = size;
        }`,
      fragmentShader: /* glsl */ `
        uniform vec3 plain;
        uniform float opacity;
        out vec4 color;
        void main() {
          ${pixels > 0 ? "if (length(gl_PointCoord - 0.5) > 0.5) discard;" : ""}
          color = vec4(plain * opacity, opacity);
        }`,
      transparent: opacity < 1,
      premultipliedAlpha: true,
      depthFunc: LessEqualDepth,
    });
    this.plain = { value: srgb(style) };
    this.pixels = pixels;
    this.size.value = pixels;
    Object.assign(this.uniforms, { plain: this.plain, opacity: { value: opacity }, size: this.size, forward: this.forward });
  }

  set style(style: string) {
    this.plain.value.copy(srgb(style));
  }

  /** Pixels of the target for one on the page. */
  set pointScale(scale: number) {
    this.size.value = this.pixels * scale;
  }

  /** Draws it in front of things that are slightly nearer. */
  bringForward(): void {
    this.forward.value = 0.01;
  }
}
