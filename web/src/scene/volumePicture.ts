/**
 * A volume at a low resolution along the rays of the picture: the maximum of its values, behind the surfaces, or all of them as a cloud, up to the surfaces. What an isovalue would
 * enclose has a colour of its own.
 */

import { Data3DTexture, LinearFilter, Matrix4, RGFormat, UnsignedByteType, Vector2, Vector3, Vector4, WebGLRenderTarget, type Color, type Texture, type WebGLRenderer } from "three";
import { indexOfEven } from "../world/places";
import { unevenOf } from "../world/uneven";
import { srgb } from "./plain";
import { planesIn, type Rays, type RayVolume } from "./rays";
import { ScreenPass } from "./screenPass";
import { worldFromIndex, type Grid, type Vec3 } from "./world";

export interface VolumeSamples {
  /** Values along each axis, and samples of a block for which a value stands. */
  readonly dims: Vec3;
  readonly factors: Vec3;
  /** What the codes 1 and 255 stand for. */
  readonly range: readonly [number, number];
  /** x fastest; 0 is missing. */
  readonly codes: Uint8Array<ArrayBuffer>;
}

export interface VolumeStyle {
  readonly isMaximum: boolean;
  readonly opacity: number;
  /** Values that are not seen, and seen best. */
  readonly window: readonly [number, number];
  /** Values from here on have a colour of their own; without it none have. */
  readonly iso: number | undefined;
  /** Colours of values: in general, and from the isovalue on. */
  readonly ink: string;
  readonly marked: string;
}

/** A plane and a box. */
const MAX_PLANES = 7;
/** Steps along a ray, at most: through all values from corner to corner. */
const MAX_STEPS = 224;
/** Density of a cloud at opacity 1, for a whole side of the volume. */
const DENSITY = 60;

const RAYS = /* glsl */ `
precision highp sampler3D;
uniform sampler3D samples;
uniform sampler2D opaque;
uniform sampler2D from;
uniform sampler2D to;
uniform bool hasFrom;
uniform bool hasTo;
uniform mat4 textureFromClip;
uniform vec4 planes[${MAX_PLANES}];
uniform int planeCount;
uniform vec3 end; // of the samples, in the texture
uniform vec3 size; // values along each axis
uniform vec2 texel;
uniform vec2 window;
uniform float iso;
uniform float opacity;
uniform bool isMaximum;
uniform vec3 ink;
uniform vec3 marked;
out vec4 color;

vec3 placeAt(vec2 uv, float depth) {
  vec4 p = textureFromClip * vec4(2.0 * vec3(uv, depth) - 1.0, 1.0);
  return p.xyz / p.w;
}

// How well a value is seen. All values may be equal.
float shareIn(float value) {
  return clamp((value - window.x) / max(window.y - window.x, 1e-6), 0.0, 1.0);
}

void main() {
  color = vec4(0.0);
  vec2 uv = gl_FragCoord.xy * texel;
  vec3 start = placeAt(uv, 0.0), way = placeAt(uv, 1.0) - start;
  float whole = dot(way, way);
  float depth = texture(opaque, uv).r;
  // A maximum is that of a whole ray: up to a surface it would be the isovalue nearly everywhere.
  if (isMaximum && depth < 1.0) return;
  if (hasTo) depth = min(depth, texture(to, uv).r);
  float first = hasFrom ? dot(placeAt(uv, texture(from, uv).r) - start, way) / whole : 0.0;
  float last = dot(placeAt(uv, depth) - start, way) / whole;
  // Within the volume, and before the planes that cut.
  for (int axis = 0; axis < 3; axis += 1) {
    if (abs(way[axis]) < 1e-9) {
      if (start[axis] < 0.0 || start[axis] > end[axis]) return;
      continue;
    }
    float a = -start[axis] / way[axis], b = (end[axis] - start[axis]) / way[axis];
    first = max(first, min(a, b));
    last = min(last, max(a, b));
  }
  for (int i = 0; i < planeCount; i += 1) {
    float here = dot(planes[i], vec4(start, 1.0)), slope = dot(planes[i].xyz, way);
    if (slope > 0.0) first = max(first, -here / slope);
    else if (slope < 0.0) last = min(last, -here / slope);
    else if (here < 0.0) return;
  }
  if (!(first < last)) return;
  float steps = clamp(ceil((last - first) * length(way * size)), 1.0, ${MAX_STEPS}.0);
  float stride = (last - first) / steps;
  // Rays begin at different places in their first step: noise in place of rings.
  float shift = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  float largest = 0.0, clear = 1.0;
  // The last values before a surface are about its isovalue: noise decides which of them are below.
  float unmarked = depth < 1.0 ? steps - 2.0 : steps;
  vec3 sum = vec3(0.0);
  float thickness = ${DENSITY}.0 * opacity * opacity * stride * length(way);
  for (float i = 0.0; i < steps; i += 1.0) {
    // Interpolated among the values that are there.
    vec2 found = texture(samples, start + way * (first + (i + shift) * stride)).rg;
    if (found.g < 0.5) continue;
    float value = found.r / found.g;
    if (isMaximum) {
      largest = max(largest, value);
      continue;
    }
    float share = shareIn(value);
    if (share == 0.0) continue;
    float cover = 1.0 - exp(-thickness * share * share);
    sum += clear * cover * (value >= iso && i < unmarked ? marked : ink) * mix(0.45, 1.0, share);
    clear *= 1.0 - cover;
    if (clear < 0.01) break;
  }
  if (!isMaximum) {
    color = vec4(sum, 1.0 - clear);
    return;
  }
  if (largest < 0.5 / 255.0) return;
  float share = shareIn(largest);
  // The border of what is marked is one step of the values wide.
  vec3 drawn = mix(ink, marked, smoothstep(-0.5, 0.5, 255.0 * (largest - iso)));
  color = vec4(drawn, 1.0) * (opacity * share);
}
`;

/** Values at even positions: those along uneven axes are taken from the nearest block. */
export function evenCodes({ dims, factors, codes }: VolumeSamples, grid: Grid): Uint8Array<ArrayBuffer> {
  const uneven = unevenOf(grid);
  if (uneven === undefined) return codes;
  const places = ([0, 1, 2] as const).map((axis) => {
    const [along, count] = [uneven[axis], dims[axis]];
    const last = (grid.dims?.[axis] ?? count * factors[axis]) - 1;
    return Array.from({ length: count }, (_, i) => {
      if (along === null) return i;
      const even = Math.min(last, Math.max(0, ((i + 0.5) / count) * (last + 1) - 0.5));
      return Math.min(count - 1, Math.floor((indexOfEven(along, even) + 0.5) / factors[axis]));
    });
  });
  const [xs = [], ys = [], zs = []] = places;
  const found = new Uint8Array(codes.length);
  let at = 0;
  for (const z of zs) for (const y of ys) for (const x of xs) found[at++] = codes[(z * dims[1] + y) * dims[0] + x] ?? 0;
  return found;
}

/** Each code, and whether there is a value. */
function withPresence(codes: Uint8Array<ArrayBuffer>): Uint8Array<ArrayBuffer> {
  const texels = new Uint8Array(2 * codes.length);
  codes.forEach((code, i) => {
    texels[2 * i] = code;
    texels[2 * i + 1] = code === 0 ? 0 : 255;
  });
  return texels;
}

/** From the world to the texture, and where the samples end in it. */
export function placeInTexture({ dims, factors }: VolumeSamples, grid: Grid): { readonly fromWorld: Matrix4; readonly end: Vector3 } {
  const uneven = unevenOf(grid);
  const samples = ([0, 1, 2] as const).map((axis) => grid.dims?.[axis] ?? dims[axis] * factors[axis]);
  // Of an uneven axis all values lie at even places among the samples.
  const sides = ([0, 1, 2] as const).map((axis) => (uneven?.[axis] === null || uneven === undefined ? dims[axis] * factors[axis] : (samples[axis] ?? 1)));
  const [x = 1, y = 1, z = 1] = sides;
  const fromIndex = new Matrix4().makeScale(1 / x, 1 / y, 1 / z).multiply(new Matrix4().makeTranslation(0.5, 0.5, 0.5));
  const [nx = 1, ny = 1, nz = 1] = samples;
  return { fromWorld: fromIndex.multiply(worldFromIndex(grid).invert()), end: new Vector3(nx / x, ny / y, nz / z) };
}

export class VolumePicture implements RayVolume {
  private readonly texture: Data3DTexture;
  private readonly fromWorld: Matrix4;
  private target: WebGLRenderTarget | undefined;
  private readonly pass: ScreenPass<ReturnType<typeof uniformsOf>>;
  isBetweenLayers = false;

  constructor(
    private readonly samples: VolumeSamples,
    grid: Grid,
  ) {
    this.texture = new Data3DTexture(withPresence(evenCodes(samples, grid)), ...samples.dims);
    Object.assign(this.texture, { format: RGFormat, type: UnsignedByteType, minFilter: LinearFilter, magFilter: LinearFilter, unpackAlignment: 1, needsUpdate: true });
    const { fromWorld, end } = placeInTexture(samples, grid);
    this.fromWorld = fromWorld;
    this.pass = new ScreenPass(RAYS, uniformsOf(this.texture, end, new Vector3(...samples.dims)));
  }

  set style({ isMaximum, opacity, window, iso, ink, marked }: VolumeStyle) {
    const { uniforms } = this.pass;
    this.isBetweenLayers = !isMaximum;
    uniforms.isMaximum.value = isMaximum;
    uniforms.opacity.value = opacity;
    uniforms.window.value.set(this.shareOf(window[0]), this.shareOf(window[1]));
    // No value is as high.
    uniforms.iso.value = iso === undefined ? 2 : this.shareOf(iso);
    uniforms.ink.value = srgb(ink);
    uniforms.marked.value = srgb(marked);
  }

  render(webgl: WebGLRenderer, { camera, clipPlanes, opaque, from, to, width, height, fineness }: Rays): Texture {
    const target = (this.target ??= new WebGLRenderTarget(1, 1, { depthBuffer: false, minFilter: LinearFilter, magFilter: LinearFilter }));
    target.setSize(Math.ceil(width * fineness), Math.ceil(height * fineness));
    const { uniforms } = this.pass;
    const worldFromView = camera.matrixWorldInverse.clone().invert();
    const textureFromView = this.fromWorld.clone().multiply(worldFromView);
    uniforms.textureFromClip.value.multiplyMatrices(textureFromView, camera.projectionMatrixInverse);
    const planes = planesIn(textureFromView.invert(), clipPlanes.slice(0, MAX_PLANES));
    planes.forEach((plane, i) => uniforms.planes.value[i]?.copy(plane));
    uniforms.planeCount.value = planes.length;
    uniforms.texel.value.set(1 / target.width, 1 / target.height);
    uniforms.opaque.value = opaque;
    uniforms.from.value = from ?? null;
    uniforms.to.value = to ?? null;
    uniforms.hasFrom.value = from !== undefined;
    uniforms.hasTo.value = to !== undefined;
    this.pass.render(webgl, target);
    return target.texture;
  }

  releaseTargets(): void {
    this.target?.dispose();
    this.target = undefined;
  }

  dispose(): void {
    this.releaseTargets();
    this.texture.dispose();
    this.pass.dispose();
  }

  /** What the texture has for a value. */
  private shareOf(value: number): number {
    const [low, high] = this.samples.range;
    return (1 + (high > low ? (254 * (value - low)) / (high - low) : value > low ? 255 : 0)) / 255;
  }
}

function uniformsOf(samples: Data3DTexture, end: Vector3, size: Vector3) {
  return {
    samples: { value: samples },
    opaque: { value: null as Texture | null },
    from: { value: null as Texture | null },
    to: { value: null as Texture | null },
    hasFrom: { value: false },
    hasTo: { value: false },
    textureFromClip: { value: new Matrix4() },
    planes: { value: Array.from({ length: MAX_PLANES }, () => new Vector4()) },
    planeCount: { value: 0 },
    end: { value: end },
    size: { value: size },
    texel: { value: new Vector2() },
    window: { value: new Vector2() },
    iso: { value: 2 },
    opacity: { value: 1 },
    isMaximum: { value: true },
    ink: { value: null as Color | null },
    marked: { value: null as Color | null },
  };
}
