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
  /** Positions of the samples in a row and of the rows, if these are uneven: how many of those steps they are from the first. */
  readonly lines?: readonly [readonly number[] | null, readonly number[] | null];
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

/** Vertices of the plane along an axis, in steps and in samples: at its ends if the samples are even, else at each sample. */
function stations(count: number, uneven: readonly number[] | null | undefined): readonly (readonly [number, number])[] {
  return uneven?.map((at, i) => [at, i] as const) ?? [[0, 0], [count - 1, count - 1]];
}

/** Plane, its coordinates and its triangles. */
export function sliceGeometry({ size: [width, height], origin, right, down, lines }: Omit<Slice, "samples" | "window" | "colors">): { readonly positions: Float32Array; readonly samples: Float32Array; readonly indices: number[] } {
  const corner = (x: number, y: number) => new Vector3(...origin).addScaledVector(new Vector3(...right), x).addScaledVector(new Vector3(...down), y);
  const [columns, rows] = [stations(width, lines?.[0]), stations(height, lines?.[1])];
  const positions = rows.flatMap(([y]) => columns.flatMap(([x]) => corner(x, y).toArray()));
  const samples = rows.flatMap(([, y]) => columns.flatMap(([, x]) => [x, y]));
  const indices = rows.slice(1).flatMap((_, j) =>
    columns.slice(1).flatMap((__, i) => {
      const [a, c] = [j * columns.length + i, (j + 1) * columns.length + i];
      return [a, a + 1, c + 1, a, c + 1, c];
    }),
  );
  return { positions: Float32Array.from(positions), samples: Float32Array.from(samples), indices };
}

function sliceMesh(slice: Slice): Mesh<BufferGeometry, ShaderMaterial> {
  const { samples, size: [width, height], window, colors } = slice;
  if (samples.length !== width * height) {
    throw new Error(`${samples.length} samples of a slice, expected ${width} × ${height}`);
  }
  const plane = sliceGeometry(slice);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(plane.positions, 3));
  geometry.setAttribute("sampleAt", new BufferAttribute(plane.samples, 2));
  geometry.setIndex(plane.indices);
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
