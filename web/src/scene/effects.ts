/** Effects computed from a rendered picture and its depth: ambient occlusion, silhouettes, and the picture with translucent layers. */

import { AlwaysDepth, Matrix4, NearestFilter, Vector2, WebGLRenderTarget, type Camera, type DepthTexture, type Texture, type WebGLRenderer } from "three";
import { ScreenPass } from "./screenPass";

const POSITION = /* glsl */ `
uniform sampler2D depth;
uniform mat4 viewFromClip;
uniform vec2 texel; // size of a pixel of the depth
vec3 positionAt(vec2 uv) {
  vec4 p = viewFromClip * vec4(2.0 * vec3(uv, texture(depth, uv).r) - 1.0, 1.0);
  return p.xyz / p.w;
}
`;

/** From the nearer neighbour on each side, so that a normal at an edge is that of its own side. */
const NORMAL = /* glsl */ `
uniform sampler2D normals; // of the surfaces; elsewhere a is 0
uniform bool hasNormals;
vec3 normalAt(vec2 uv, vec3 p) {
  vec4 known = texture(normals, uv);
  if (hasNormals && known.a > 0.5) return normalize(2.0 * known.xyz - 1.0);
  vec3 r = positionAt(uv + vec2(texel.x, 0.0)) - p, l = p - positionAt(uv - vec2(texel.x, 0.0));
  vec3 t = positionAt(uv + vec2(0.0, texel.y)) - p, b = p - positionAt(uv - vec2(0.0, texel.y));
  return normalize(cross(abs(r.z) < abs(l.z) ? r : l, abs(t.z) < abs(b.z) ? t : b));
}
`;

/** Samples a pixel; their pattern turns from pixel to pixel in tiles of 4 × 4, over which the resolving pass averages. */
const SAMPLES = 9;

/** Scalable ambient obscurance (McGuire et al. 2012), of a radius in view space. */
const OCCLUSION = /* glsl */ `
${POSITION}
${NORMAL}
uniform float radius;
uniform float coarseness; // pixels of the depth for one here
uniform float pixelsPerUnit; // at distance 1, or everywhere in an orthographic view
uniform bool isOrthographic;
out vec4 color;
void main() {
  vec2 uv = gl_FragCoord.xy * texel * coarseness;
  if (texture(depth, uv).r == 1.0) { color = vec4(1.0); return; }
  vec3 p = positionAt(uv);
  vec3 n = normalAt(uv, p);
  ivec2 tile = ivec2(gl_FragCoord.xy) & 3;
  float turn = float((tile.x * 4 + tile.y * 9 + (tile.x ^ tile.y) * 5) & 15) / 16.0 * 6.28319;
  float reach = radius * pixelsPerUnit / (isOrthographic ? 1.0 : -p.z);
  float sum = 0.0;
  for (int i = 0; i < ${SAMPLES}; i += 1) {
    float share = (float(i) + 0.5) / ${SAMPLES}.0;
    float angle = turn + share * 25.1327; // four turns
    vec3 v = positionAt(uv + share * reach * vec2(cos(angle), sin(angle)) * texel) - p;
    float far = dot(v, v);
    float near = max(radius * radius - far, 0.0);
    sum += near * near * near * max((dot(v, n) - 0.002 * abs(p.z) - 0.03 * radius) / (far + 0.002 * radius * radius), 0.0);
  }
  float r2 = radius * radius;
  color = vec4(max(1.0 - 3.2 * sum * radius / (r2 * r2 * r2 * ${SAMPLES}.0), 0.0));
}
`;

const RESOLVE = /* glsl */ `
${POSITION}
${NORMAL}
uniform float coarseness;
uniform sampler2D picture;
uniform sampler2D occlusion;
uniform sampler2D layers;
uniform sampler2D volume;
uniform bool hasOcclusion;
uniform bool hasSilhouettes;
uniform bool hasLayers;
uniform bool hasVolume;
uniform float lineWidth; // pixels
uniform float radius;
out vec4 color;

float viewDepth(vec2 uv) { return -positionAt(uv).z; }

// The average over a tile of the pattern, of samples near the plane of this one: on a slope, depths alone would leave out half of the tile.
float occlusionAt(vec2 uv) {
  vec3 p = positionAt(uv), n = normalAt(uv, p);
  float sum = 0.0, weight = 0.0;
  for (int y = -2; y < 2; y += 1) for (int x = -2; x < 2; x += 1) {
    vec2 at = uv + (vec2(x, y) + 0.5) * texel * coarseness;
    float w = 0.001 + max(0.0, 1.0 - 20.0 * abs(dot(positionAt(at) - p, n)) / radius);
    sum += w * texture(occlusion, at).r;
    weight += w;
  }
  return sum / weight;
}

// How sharply the depth bends; a plane seen from any side has 0.
float bend(vec2 uv, float here) {
  vec2 o = lineWidth * texel;
  float x = viewDepth(uv + vec2(o.x, 0.0)) + viewDepth(uv - vec2(o.x, 0.0)) - 2.0 * here;
  float y = viewDepth(uv + vec2(0.0, o.y)) + viewDepth(uv - vec2(0.0, o.y)) - 2.0 * here;
  return max(x, y);
}

void main() {
  vec2 uv = gl_FragCoord.xy * texel;
  float z = texture(depth, uv).r;
  color = texture(picture, uv);
  if (z < 1.0) {
    float here = viewDepth(uv);
    if (hasOcclusion) color.rgb *= mix(0.25, 1.0, occlusionAt(uv));
    if (hasSilhouettes) color.rgb *= 1.0 - 0.85 * smoothstep(0.03, 0.09, bend(uv, here) / radius);
  }
  if (hasVolume) {
    vec4 front = texture(volume, uv);
    color = front + (1.0 - front.a) * color;
  }
  if (hasLayers) {
    vec4 front = texture(layers, uv);
    color = front + (1.0 - front.a) * color;
  }
  gl_FragDepth = z;
}
`;

export interface Resolve {
  readonly picture: Texture;
  readonly depth: DepthTexture;
  /** Normals of the surfaces in view space, from 0 to 1; without them those of the depth. */
  readonly normals: Texture | undefined;
  /** Translucent layers before it. */
  readonly layers: Texture | undefined;
  /** A volume before the picture, and behind the layers. */
  readonly volume: Texture | undefined;
  readonly occlusion: boolean;
  readonly silhouettes: boolean;
  /** Pixels of the target for one on the page. */
  readonly scale: number;
  /** Of what is shown. */
  readonly radius: number;
  readonly camera: Camera;
  readonly target: WebGLRenderTarget | null;
}

/** Reach of ambient occlusion, in radii of what is shown. */
const REACH = 0.07;

export class Effects {
  private readonly occluded = new WebGLRenderTarget(1, 1, { depthBuffer: false, minFilter: NearestFilter, magFilter: NearestFilter });
  private readonly position = {
    depth: { value: null as Texture | null },
    viewFromClip: { value: new Matrix4() },
    texel: { value: new Vector2() },
    coarseness: { value: 1 },
    normals: { value: null as Texture | null },
    hasNormals: { value: false },
  };
  private readonly occlusion = new ScreenPass(OCCLUSION, {
    ...this.position,
    radius: { value: 1 },
    pixelsPerUnit: { value: 1 },
    isOrthographic: { value: false },
  });
  private readonly resolving = new ScreenPass(
    RESOLVE,
    {
      ...this.position,
      picture: { value: null as Texture | null },
      occlusion: { value: this.occluded.texture },
      layers: { value: null as Texture | null },
      volume: { value: null as Texture | null },
      hasVolume: { value: false },
      hasOcclusion: { value: false },
      hasSilhouettes: { value: false },
      hasLayers: { value: false },
      lineWidth: { value: 1 },
      radius: { value: 1 },
    },
    // Depth too, for things drawn over the picture.
    { depthTest: true, depthWrite: true, depthFunc: AlwaysDepth },
  );

  /** Writes the picture with all effects, and its depth, to the target. */
  resolve(webgl: WebGLRenderer, of: Resolve): void {
    const { width, height } = of.depth.image as { width: number; height: number };
    this.position.depth.value = of.depth;
    this.position.viewFromClip.value.copy(of.camera.projectionMatrixInverse);
    this.position.texel.value.set(1 / width, 1 / height);
    this.position.normals.value = of.normals ?? null;
    this.position.hasNormals.value = of.normals !== undefined;
    if (of.occlusion) this.renderOcclusion(webgl, of, width, height);
    const { uniforms } = this.resolving;
    uniforms.picture.value = of.picture;
    uniforms.layers.value = of.layers ?? null;
    uniforms.hasLayers.value = of.layers !== undefined;
    uniforms.volume.value = of.volume ?? null;
    uniforms.hasVolume.value = of.volume !== undefined;
    uniforms.hasOcclusion.value = of.occlusion;
    uniforms.hasSilhouettes.value = of.silhouettes;
    uniforms.lineWidth.value = Math.max(1, of.scale);
    uniforms.radius.value = of.radius;
    this.resolving.render(webgl, of.target);
  }

  dispose(): void {
    this.occluded.dispose();
  }

  private renderOcclusion(webgl: WebGLRenderer, { camera, radius, target }: Resolve, width: number, height: number): void {
    const { coarseness } = this.position;
    // On screen half the width and height suffice, because occlusion is smooth.
    coarseness.value = target === null ? 2 : 1;
    this.occluded.setSize(Math.ceil(width / coarseness.value), Math.ceil(height / coarseness.value));
    const { uniforms } = this.occlusion;
    uniforms.radius.value = REACH * radius;
    uniforms.pixelsPerUnit.value = (camera.projectionMatrix.elements[5] * height) / 2;
    uniforms.isOrthographic.value = camera.projectionMatrix.elements[15] === 1;
    this.occlusion.render(webgl, this.occluded);
  }
}
