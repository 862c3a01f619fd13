/** Materials of the surface: the same light, three ways to colour it. Colours come from tables that the owner passes. */

import {
  Color,
  DataTexture,
  DoubleSide,
  FloatType,
  GLSL3,
  Matrix3,
  RGBAFormat,
  ShaderMaterial,
  type IUniform,
} from "three";
import { linearFromSrgb, lookUp } from "./colorTable";

/** What colour shows. */
export type ColorMode = "transfer" | "level" | "importance";

/** Uniforms that all surface materials share, typed so that a wrong name does not compile. */
interface SharedUniforms extends Record<string, IUniform> {
  /** Weight of the feature against smoothness. */
  readonly alpha: IUniform<number>;
  readonly worldFromGrid: IUniform<Matrix3>;
}

const VERTEX = /* glsl */ `
uniform float alpha;
uniform mat3 worldFromGrid;
// All 16-bit words of a vertex are one signed attribute array; these three are unsigned.
in float packedNormal; // two signed bytes, octahedral, x low
in vec2 features;      // s and normalised feature, over 65535
out vec3 viewNormal;
out vec3 viewPosition;
out float blended;

vec2 unsignedWords(vec2 words) {
  return words + 65536.0 * vec2(lessThan(words, vec2(0.0)));
}

vec3 unpackNormal(float word) {
  vec2 e = vec2(mod(word, 256.0), floor(word / 256.0));
  e = max((e - 256.0 * step(128.0, e)) / 127.0, -1.0);
  float z = 1.0 - abs(e.x) - abs(e.y);
  if (z < 0.0) e = (1.0 - abs(e.yx)) * vec2(e.x < 0.0 ? -1.0 : 1.0, e.y < 0.0 ? -1.0 : 1.0);
  return normalize(vec3(e, z));
}

void main() {
  vec4 p = modelViewMatrix * vec4(position, 1.0);
  viewPosition = p.xyz;
  viewNormal = mat3(viewMatrix) * (worldFromGrid * unpackNormal(unsignedWords(vec2(packedNormal)).x));
  vec2 sf = unsignedWords(features) / 65535.0;
  blended = (1.0 - alpha) * sf.x + alpha * sf.y;
  gl_Position = projectionMatrix * p;
}
`;

/**
 * On a processor every instruction costs. The table holds linear light and is fetched without a filter (a filtered fetch from
 * sRGB costs as much as the whole lighting), and powers are computed by products and roots.
 */
const FRAGMENT = /* glsl */ `
uniform highp sampler2D colors; // linear light over the blended feature
in vec3 viewNormal;
in vec3 viewPosition;
in float blended;
out vec4 color;

// The sRGB curve to within half an 8-bit step for light above 0.003.
vec3 toSrgb(vec3 light) {
  vec3 root2 = sqrt(light);
  vec3 root4 = sqrt(root2);
  return 0.585122 * root2 + 0.783140 * root4 - 0.368263 * sqrt(root4);
}

void main() {
  // The centres of the first and last entry are 0 and 1.
  int entry = int(clamp(blended, 0.0, 1.0) * float(textureSize(colors, 0).x - 1) + 0.5);
  vec3 base = texelFetch(colors, ivec2(entry, 0), 0).rgb;

  vec3 outward = normalize(viewNormal);
  vec3 v = normalize(-viewPosition);
  // At the silhouette an interpolated normal points away a little without showing the inside; flipped, it would give dark dots.
  float side = dot(outward, v);
  bool inside = side < -0.25;
  vec3 n = inside ? -outward : outward;
  const vec3 key = vec3(-0.424, 0.566, 0.707);  // over the viewer's left shoulder
  const vec3 fill = vec3(0.780, -0.069, 0.622); // from the right
  float sky = 0.5 + 0.5 * n.y;
  vec3 ambient = mix(vec3(0.150, 0.140, 0.135), vec3(0.270, 0.285, 0.310), sky);
  float facing = max(dot(n, v), 0.0);
  float lambert = 0.70 * max(dot(n, key), 0.0) + 0.16 * max(dot(n, fill), 0.0) + 0.16 * facing;
  float grazing = (1.0 - facing) * (1.0 - facing) * (1.0 - facing);
  vec3 lit = base * (ambient + lambert) * (1.0 - 0.35 * grazing);
  float highlight = max(dot(n, normalize(key + v)), 0.0);
  highlight *= highlight;
  highlight *= highlight;                      // to the 4th
  float fourth = highlight;
  highlight *= highlight;
  highlight *= highlight;
  highlight *= highlight * fourth;             // to the 36th
  lit += 0.085 * highlight;
  // Darken the inside, seen through an opening.
  if (inside) lit *= 0.55;
  color = vec4(toSrgb(lit), 1.0);
}
`;

const WIRE_FRAGMENT = /* glsl */ `
uniform vec3 wireColor;
uniform float wireOpacity;
in vec3 viewNormal;
in vec3 viewPosition;
in float blended;
out vec4 color;
void main() {
  color = linearToOutputTexel(vec4(wireColor, wireOpacity));
}
`;

function row(colors: Float32Array<ArrayBuffer>): DataTexture {
  const texture = new DataTexture(colors, colors.length / 4, 1, RGBAFormat, FloatType);
  texture.needsUpdate = true;
  return texture;
}

/** Lookup tables; colours in sRGB. */
export interface ColorTables {
  /** RGBA bytes over the blended feature: colour and importance. */
  readonly transfer: Uint8Array<ArrayBuffer>;
  /** RGBA bytes over importance. */
  readonly importance: Uint8Array<ArrayBuffer>;
  /** One colour a level, finest first. */
  readonly levels: readonly string[];
}

/** The surface's materials: one for the whole, one for each level, one for the edges. */
export class SurfaceMaterials {
  readonly whole: ShaderMaterial;
  /** One a level, for meshes with a group a level. */
  readonly levels: ShaderMaterial[];
  readonly wire: ShaderMaterial;
  private readonly shared: SharedUniforms = { alpha: { value: 0 }, worldFromGrid: { value: new Matrix3() } };
  private readonly colors: IUniform<DataTexture>;
  private readonly ramp: Uint8Array<ArrayBuffer>;
  private transferTable: Uint8Array<ArrayBuffer>;
  private readonly wireColor = new Color();
  private importance = false;

  constructor({ transfer, importance, levels }: ColorTables) {
    this.transferTable = transfer;
    this.ramp = importance;
    const surface = (colors: IUniform<DataTexture>) =>
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        side: DoubleSide,
        // Avoids depth fighting with the edges.
        polygonOffset: true,
        polygonOffsetFactor: 1,
        polygonOffsetUnits: 1,
        // Not cloned, so that all materials share the values.
        uniforms: { ...this.shared, colors },
      });
    this.colors = { value: row(linearFromSrgb(transfer)) };
    this.whole = surface(this.colors);
    this.levels = levels.map((color) => surface({ value: row(new Float32Array([...new Color(color).toArray(), 1])) }));
    this.wire = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: WIRE_FRAGMENT,
      wireframe: true,
      transparent: true,
      depthWrite: false,
      uniforms: { ...this.shared, wireColor: { value: this.wireColor }, wireOpacity: { value: 0.42 } },
    });
  }

  /** The mode `level` needs nothing here: each level has a material of its own. */
  set mode(mode: ColorMode) {
    this.importance = mode === "importance";
    this.recolor();
  }

  get alpha(): number {
    return this.shared.alpha.value;
  }

  set alpha(alpha: number) {
    this.shared.alpha.value = alpha;
  }

  set worldFromGrid(matrix: Matrix3) {
    this.shared.worldFromGrid.value = matrix;
  }

  /** RGBA over the blended feature: colour and importance. */
  set transfer(bytes: Uint8Array<ArrayBuffer>) {
    this.transferTable = bytes;
    this.recolor();
  }

  set edges(color: string) {
    this.wireColor.set(color);
  }

  private recolor(): void {
    const bytes = this.importance ? lookUp(this.transferTable, this.ramp) : this.transferTable;
    this.colors.value.dispose();
    this.colors.value = row(linearFromSrgb(bytes));
  }
}
