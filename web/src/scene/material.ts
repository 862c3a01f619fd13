/** Materials of the surface: one look, three ways to colour it. Colours come from tables the owner hands in. */

import {
  Color,
  DataTexture,
  DoubleSide,
  GLSL3,
  LinearFilter,
  Matrix3,
  RGBAFormat,
  ShaderMaterial,
  SRGBColorSpace,
  UnsignedByteType,
  type IUniform,
} from "three";

/** What colour shows. */
export type ColorMode = "transfer" | "level" | "importance";

const MODES: Readonly<Record<ColorMode, number>> = { transfer: 0, importance: 1, level: 2 };

/** Uniforms all surface materials share; declared once, so a wrong name does not compile. */
interface SurfaceUniforms extends Record<string, IUniform> {
  readonly mode: IUniform<number>;
  /** Weight of the feature against smoothness. */
  readonly alpha: IUniform<number>;
  /** RGB colour, A importance, over the blended feature. */
  readonly transferLut: IUniform<DataTexture>;
  /** RGB colour over importance. */
  readonly importanceLut: IUniform<DataTexture>;
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

const FRAGMENT = /* glsl */ `
uniform int mode;
uniform vec3 levelColor;
uniform sampler2D transferLut;
uniform sampler2D importanceLut;
in vec3 viewNormal;
in vec3 viewPosition;
in float blended;
out vec4 color;

// Texel centres of the first and last entry are 0 and 1.
vec4 lookup(sampler2D lut, float x) {
  float size = float(textureSize(lut, 0).x);
  return texture(lut, vec2((clamp(x, 0.0, 1.0) * (size - 1.0) + 0.5) / size, 0.5));
}

void main() {
  vec3 base;
  if (mode == 2) {
    base = levelColor;
  } else {
    vec4 transfer = lookup(transferLut, blended);
    base = mode == 0 ? transfer.rgb : lookup(importanceLut, transfer.a).rgb;
  }

  vec3 n = normalize(viewNormal) * (gl_FrontFacing ? 1.0 : -1.0);
  vec3 v = normalize(-viewPosition);
  const vec3 key = vec3(-0.424, 0.566, 0.707);  // over the viewer's left shoulder
  const vec3 fill = vec3(0.780, -0.069, 0.622); // from the right
  float sky = 0.5 + 0.5 * n.y;
  vec3 ambient = mix(vec3(0.150, 0.140, 0.135), vec3(0.270, 0.285, 0.310), sky);
  float lambert = 0.70 * max(dot(n, key), 0.0) + 0.16 * max(dot(n, fill), 0.0) + 0.16 * max(dot(n, v), 0.0);
  float grazing = pow(1.0 - max(dot(n, v), 0.0), 3.0);
  vec3 lit = base * (ambient + lambert) * (1.0 - 0.35 * grazing);
  float highlight = pow(max(dot(n, normalize(key + v)), 0.0), 36.0);
  lit += 0.085 * highlight;
  // The inside, seen through an opening, stays back.
  if (!gl_FrontFacing) lit *= 0.55;
  color = linearToOutputTexel(vec4(lit, 1.0));
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

function table(bytes: Uint8Array<ArrayBuffer>): DataTexture {
  const texture = new DataTexture(bytes, bytes.length / 4, 1, RGBAFormat, UnsignedByteType);
  texture.colorSpace = SRGBColorSpace;
  texture.minFilter = LinearFilter;
  texture.magFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

/** The surface's materials: one for the whole, one for each level, one for the edges. */
export class SurfaceMaterials {
  readonly whole: ShaderMaterial;
  /** In the order of levels, for meshes drawn in one group a level. */
  readonly levels: ShaderMaterial[];
  readonly wire: ShaderMaterial;
  private readonly shared: SurfaceUniforms;
  private readonly wireColor = new Color();

  constructor(tables: { transfer: Uint8Array<ArrayBuffer>; importance: Uint8Array<ArrayBuffer>; levels: readonly string[] }) {
    this.shared = {
      mode: { value: MODES.transfer },
      alpha: { value: 0 },
      transferLut: { value: table(tables.transfer) },
      importanceLut: { value: table(tables.importance) },
      worldFromGrid: { value: new Matrix3() },
    };
    const surface = (levelColor: Color) =>
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        side: DoubleSide,
        // Edges drawn over the surface must not fight with it.
        polygonOffset: true,
        polygonOffsetFactor: 1,
        polygonOffsetUnits: 1,
        // Not cloned: all materials see the same values.
        uniforms: { ...this.shared, levelColor: { value: levelColor } },
      });
    this.whole = surface(new Color());
    this.levels = tables.levels.map((color) => surface(new Color(color)));
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

  set mode(mode: ColorMode) {
    this.shared.mode.value = MODES[mode];
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
    this.shared.transferLut.value.dispose();
    this.shared.transferLut.value = table(bytes);
  }

  set edges(color: string) {
    this.wireColor.set(color);
  }

  dispose(): void {
    for (const material of [this.whole, this.wire, ...this.levels]) material.dispose();
    this.shared.transferLut.value.dispose();
    this.shared.importanceLut.value.dispose();
  }
}
