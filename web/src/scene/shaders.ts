/** Shaders of the surface. What differs between materials and passes is compiled in, for on a processor every instruction costs. */

import type { Shading } from "./look";

/** What a program does; each combination is compiled once, when it is first used. */
export interface ProgramVariant {
  readonly shading: Shading;
  /** Colour from a table over the blended feature, over it on a scale, one for all, or from a table over the value of each vertex. */
  readonly source: "table" | "scale" | "logScale" | "tint" | "value";
  readonly flat: boolean;
  /** Draws the nearest fragments behind those of the layer before, translucent. */
  readonly peel: boolean;
  /** Colours on a scale are of a field's values, and not of the feature. */
  readonly ofValues: boolean;
  /** Regions have colours of their own. */
  readonly regions: boolean;
  /** There are isolines; only if colours are on a scale. */
  readonly isolines: boolean;
}

/** As many isolines as a program can draw. */
export const MAX_ISOLINES = 24;

/** What a mesh has whose vertices have no values. */
export const NO_VALUE = -1e30;

export const VERTEX = /* glsl */ `
uniform float alpha;
uniform mat3 worldFromGrid;
uniform vec3 normalScale;  // of the world as it is shown
// All 16-bit words of a vertex are one signed attribute array; these three are unsigned.
in float packedNormal; // two signed bytes, octahedral, x low
in vec2 features;      // s and normalised feature, over 65535
uniform vec2 valueRange;
in float value;
#ifdef FIELD_VALUES
in float fieldValue;
out float missing;     // 1 if the field has no value
#endif
out vec3 viewNormal;
out vec3 viewPosition;
out float shown;       // what is looked up in the table
#ifdef REGIONS
out vec3 worldPosition;
#endif

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
#ifdef REGIONS
  worldPosition = (modelMatrix * vec4(position, 1.0)).xyz;
#endif
  viewPosition = p.xyz;
  viewNormal = normalize(mat3(viewMatrix) * (normalScale * (worldFromGrid * unpackNormal(unsignedWords(vec2(packedNormal)).x))));
#ifdef VALUE
  shown = value < ${0.5 * NO_VALUE} ? -1.0 : max((value - valueRange.x) / (valueRange.y - valueRange.x), 0.0);
#elif defined(FIELD_VALUES)
  missing = fieldValue < ${0.5 * NO_VALUE} ? 1.0 : 0.0;
  shown = missing > 0.5 ? 0.0 : fieldValue;
#else
  vec2 sf = unsignedWords(features) / 65535.0;
  shown = (1.0 - alpha) * sf.x + alpha * sf.y;
#endif
  gl_Position = projectionMatrix * p;
}
`;

/** Discards what the clipping planes cut away: `PLANES` of them, in view space. */
const CLIPPED = /* glsl */ `
#if PLANES > 0
uniform vec4 clipPlanes[PLANES];
void clipAway(vec3 p) {
  for (int i = 0; i < PLANES; i += 1) if (dot(clipPlanes[i], vec4(p, 1.0)) < 0.0) discard;
}
#else
#define clipAway(p)
#endif
`;

const OUTPUT = /* glsl */ `
// The sRGB curve to within half an 8-bit step for light above 0.003.
vec3 toSrgb(vec3 light) {
  vec3 root2 = sqrt(light);
  vec3 root4 = sqrt(root2);
  return 0.585122 * root2 + 0.783140 * root4 - 0.368263 * sqrt(root4);
}
`;

/** Fragments of a surface. The table holds linear light and is fetched without a filter: a filtered fetch from sRGB costs as much as the whole lighting. */
export function surfaceFragment({ shading, source, ofValues, flat, peel, regions, isolines }: ProgramVariant): string {
  const isScaled = source === "scale" || source === "logScale";
  return /* glsl */ `
uniform highp sampler2D colors; // linear light over what is looked up
uniform vec3 tint;
${peel ? "uniform highp sampler2D nearer;\nuniform highp sampler2D opaque;\nuniform float opacity;" : ""}
${isScaled ? "uniform vec4 scale;" : ""}
${isolines ? `uniform float isolines[${MAX_ISOLINES}];\nuniform int isolineCount;\nuniform float isolineWidth;` : ""}
in vec3 viewNormal;
in vec3 viewPosition;
in float shown;
${ofValues ? "in float missing;" : ""}
${regions ? "uniform highp sampler2D regions;\nin vec3 worldPosition;" : ""}
out vec4 color;
${CLIPPED}
${OUTPUT}

void main() {
  clipAway(viewPosition);
  ${peel ? PEELED : ""}
  ${isScaled ? (source === "logScale" ? LOG_SCALE : "float place = shown * scale.x + scale.y;") : "float place = shown;"}
  ${source === "tint" ? "vec3 base = tint;" : LOOK_UP}
  ${source === "logScale" ? "if (value <= 0.0) base = vec3(0.3);" : ""}
  ${isolines ? ISOLINES : ""}
  ${ofValues ? "if (missing > 0.001) base = vec3(0.3);" : ""}
  ${regions ? IN_REGIONS : ""}
  ${source === "value" ? "if (shown < -0.5) base = vec3(0.3);" : ""}
  vec3 v = isOrthographic ? vec3(0.0, 0.0, 1.0) : normalize(-viewPosition);
  ${flat ? FLAT : SMOOTH}
  ${light(shading)}
  // Darken the inside, seen through an opening.
  ${isUnlit(shading) ? "" : "if (inside) lit *= 0.55;"}
  color = ${peel ? "vec4(toSrgb(lit) * opacity, opacity)" : "vec4(toSrgb(lit), 1.0)"};
}
`;
}

const PEELED = /* glsl */ `
  ivec2 at = ivec2(gl_FragCoord.xy);
  if (gl_FragCoord.z <= texelFetch(nearer, at, 0).r || gl_FragCoord.z >= texelFetch(opaque, at, 0).r) discard;`;

/** The centres of the first and last entry are 0 and 1. */
const LOOK_UP = /* glsl */ `
  int entry = int(clamp(place, 0.0, 1.0) * float(textureSize(colors, 0).x - 1) + 0.5);
  vec3 base = texelFetch(colors, ivec2(entry, 0), 0).rgb;`;

/** Values are `scale.x + scale.y * shown`; the logarithm of the first colour's is `scale.z`, and `scale.w` is one over the length of the range. */
const LOG_SCALE = /* glsl */ `
  float value = scale.x + scale.y * shown;
  float place = (log2(max(value, 1e-37)) - scale.z) * scale.w;`;

/** Lines of one width on screen, dark on light colours and light on dark ones. */
const ISOLINES = /* glsl */ `
  float apart = 1e9;
  for (int i = 0; i < isolineCount; i += 1) apart = min(apart, abs(place - isolines[i]));
  float line = clamp(0.5 + isolineWidth - apart / max(fwidth(place), 1e-7), 0.0, 1.0);
  base = mix(base, dot(base, vec3(0.2126, 0.7152, 0.0722)) > 0.18 ? vec3(0.0) : vec3(0.9), 0.8 * line);`;

/** The most important region, if it is more important than what the table has here (`regionTexture`). */
const IN_REGIONS = /* glsl */ `
  float importance = texelFetch(colors, ivec2(entry, 0), 0).a;
  for (int i = 0; i < textureSize(regions, 0).x; i += 1) {
    vec4 low = texelFetch(regions, ivec2(i, 0), 0);
    vec4 high = texelFetch(regions, ivec2(i, 1), 0);
    bool within = low.w > 0.0
      ? distance(worldPosition, low.xyz) <= low.w
      : all(greaterThanEqual(worldPosition, low.xyz)) && all(lessThanEqual(worldPosition, high.xyz));
    if (!within || high.w <= importance) continue;
    importance = high.w;
    base = texelFetch(regions, ivec2(i, 2), 0).rgb;
  }`;

/** At the silhouette an interpolated normal points away a little without showing the inside; flipped, it would give dark dots. */
const SMOOTH = /* glsl */ `
  vec3 outward = normalize(viewNormal);
  float side = dot(outward, v);
  bool inside = side < -0.25;
  vec3 n = inside ? -outward : outward;`;

/** The triangle's own normal, towards the eye; what points away from it on average is the inside. */
const FLAT = /* glsl */ `
  vec3 n = normalize(cross(dFdx(viewPosition), dFdy(viewPosition)));
  if (dot(n, v) < 0.0) n = -n;
  bool inside = dot(n, viewNormal) < 0.0;`;

function isUnlit(shading: Shading): boolean {
  return shading.key === 0 && shading.head === 0;
}

const number = (value: number) => value.toFixed(4);
const vector = (value: readonly number[]) => `vec3(${value.map(number).join(", ")})`;

function light(shading: Shading): string {
  if (isUnlit(shading)) return "vec3 lit = base;";
  const { ground, sky, key, fill, head, wrap, falloff, gloss, glossPower, mirror } = shading;
  const lambert = (light: string) =>
    wrap === 0 ? `max(dot(n, ${light}), 0.0)` : `max((dot(n, ${light}) + ${number(wrap)}) / ${number(1 + wrap)}, 0.0)`;
  return /* glsl */ `
  const vec3 key = vec3(-0.424, 0.566, 0.707);  // over the viewer's left shoulder
  const vec3 fill = vec3(0.780, -0.069, 0.622); // from the right
  vec3 ambient = mix(${vector(ground)}, ${vector(sky)}, 0.5 + 0.5 * n.y);
  float facing = max(dot(n, v), 0.0);
  float diffuse = ${number(key)} * ${lambert("key")} + ${number(fill)} * ${lambert("fill")} + ${number(head)} * facing;
  float grazing = (1.0 - facing) * (1.0 - facing) * (1.0 - facing);
  vec3 lit = base * (ambient + diffuse) * (1.0 - ${number(falloff)} * grazing);
  ${mirror === 0 ? "" : reflection(mirror)}
  ${gloss === 0 ? "" : highlight(gloss, glossPower)}`;
}

/** Surroundings that are bright above, dark at the horizon and dim below. */
const reflection = (share: number) => /* glsl */ `
  float r = 2.0 * dot(n, v) * n.y - v.y;
  float surroundings = 0.12 + 0.95 * smoothstep(0.05, 0.75, r) + 0.22 * smoothstep(0.15, 0.9, -r);
  lit += base * ${number(share)} * surroundings * (1.0 + grazing);`;

const highlight = (weight: number, power: number) => /* glsl */ `
  float glint = max(dot(n, normalize(key + v)), 0.0);
  ${"glint *= glint;\n  ".repeat(power)}lit += ${number(weight)} * glint;`;

export const WIRE_FRAGMENT = /* glsl */ `
uniform vec3 wireColor;
uniform float wireOpacity;
in vec3 viewPosition;
out vec4 color;
${CLIPPED}
void main() {
  clipAway(viewPosition);
  color = vec4(wireColor * wireOpacity, wireOpacity);
}
`;

/** No colour: for passes of which only depth or stencil counts. */
export const MASK_FRAGMENT = /* glsl */ `
in vec3 viewPosition;
out vec4 color;
${CLIPPED}
void main() {
  clipAway(viewPosition);
  color = vec4(0.0);
}
`;

/** Writes the position of the surface in view space, and the surface's number. */
export const PICK_FRAGMENT = /* glsl */ `
uniform float surface;
in vec3 viewPosition;
out vec4 color;
${CLIPPED}
void main() {
  clipAway(viewPosition);
  color = vec4(viewPosition, surface + 1.0);
}
`;

/** The surface's normal towards the eye, in view space, halved and from 0 to 1. */
export const NORMAL_FRAGMENT = /* glsl */ `
in vec3 viewNormal;
in vec3 viewPosition;
out vec4 color;
${CLIPPED}
void main() {
  clipAway(viewPosition);
  vec3 n = normalize(viewNormal);
  vec3 v = isOrthographic ? vec3(0.0, 0.0, 1.0) : normalize(-viewPosition);
  color = vec4(0.5 + 0.5 * (dot(n, v) < -0.25 ? -n : n), 1.0);
}
`;
