/** Slices through the volume, as planes in the world with their samples as brightness or colour. */

import {
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  DoubleSide,
  FloatType,
  GLSL3,
  Group,
  Mesh,
  RedFormat,
  RGBAFormat,
  ShaderMaterial,
  UnsignedByteType,
  Vector2,
  Vector3,
} from "three";
import type { Vec3 } from "./world";

export interface Slice {
  /** Row after row, as many as `size` says. */
  readonly samples: Uint8Array | Int8Array | Uint16Array | Int16Array | Int32Array | Uint32Array | Float32Array;
  /** Samples in a row, and rows. */
  readonly size: readonly [number, number];
  /** World position of the first sample. */
  readonly origin: Vec3;
  /** World vectors from a sample to the next one in its row, and to the next row. */
  readonly right: Vec3;
  readonly down: Vec3;
  /** Values that are black and white. */
  readonly window: readonly [number, number];
  /** RGBA bytes over the window; without them grey. */
  readonly colors?: Uint8Array<ArrayBuffer>;
}

/** Sample centres lie on the quad's corners; values between are interpolated here, for floats have no filter everywhere. */
const FRAGMENT = /* glsl */ `
uniform highp sampler2D samples;
uniform sampler2D colors;
uniform vec2 window;
in vec2 at;
out vec4 color;
void main() {
  ivec2 last = textureSize(samples, 0) - 1;
  vec2 cell = min(floor(at), vec2(max(last - 1, 0)));
  ivec2 low = ivec2(cell), high = min(low + 1, last);
  vec2 t = at - cell;
  float a = texelFetch(samples, low, 0).r, b = texelFetch(samples, ivec2(high.x, low.y), 0).r;
  float c = texelFetch(samples, ivec2(low.x, high.y), 0).r, d = texelFetch(samples, high, 0).r;
  float value = mix(mix(a, b, t.x), mix(c, d, t.x), t.y);
  // A missing sample is not a number.
  if (isnan(value)) discard;
  float share = clamp((value - window.x) / (window.y - window.x), 0.0, 1.0);
  color = vec4(texture(colors, vec2(share * (255.0 / 256.0) + 0.5 / 256.0, 0.5)).rgb, 1.0);
}
`;

const VERTEX = /* glsl */ `
in vec2 sampleAt;
out vec2 at;
void main() {
  at = sampleAt;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
}
`;

export class Slices {
  readonly object = new Group();
  private planes: Mesh<BufferGeometry, ShaderMaterial>[] = [];

  /** Shows these slices, and none besides. */
  set(slices: readonly Slice[]): void {
    for (const { geometry, material } of this.planes) {
      geometry.dispose();
      for (const name of ["samples", "colors"]) (material.uniforms[name]?.value as DataTexture).dispose();
      material.dispose();
    }
    this.object.clear();
    this.planes = slices.map(sliceMesh);
    if (this.planes.length > 0) this.object.add(...this.planes);
  }
}

function sliceMesh({ samples, size: [width, height], origin, right, down, window, colors }: Slice): Mesh<BufferGeometry, ShaderMaterial> {
  if (samples.length !== width * height) {
    throw new Error(`${samples.length} samples of a slice, expected ${width} × ${height}`);
  }
  const corner = (x: number, y: number) => new Vector3(...origin).addScaledVector(new Vector3(...right), x).addScaledVector(new Vector3(...down), y);
  const [w, h] = [width - 1, height - 1];
  const ends = [[0, 0], [w, 0], [w, h], [0, h]] as const;
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends.flatMap(([x, y]) => corner(x, y).toArray())), 3));
  geometry.setAttribute("sampleAt", new BufferAttribute(new Float32Array(ends.flat()), 2));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  const texture = new DataTexture(Float32Array.from(samples), width, height, RedFormat, FloatType);
  texture.needsUpdate = true;
  const ramp = new DataTexture(colors ?? greys(), (colors?.length ?? 1024) / 4, 1, RGBAFormat, UnsignedByteType);
  ramp.needsUpdate = true;
  const uniforms = { samples: { value: texture }, colors: { value: ramp }, window: { value: new Vector2(...window) } };
  return new Mesh(geometry, new ShaderMaterial({ glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide, uniforms }));
}

function greys(): Uint8Array<ArrayBuffer> {
  return Uint8Array.from({ length: 1024 }, (_, i) => (i % 4 === 3 ? 255 : i >> 2));
}
