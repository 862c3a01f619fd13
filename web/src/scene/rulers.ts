/** Lines between places in the world, with a text beside them. What the surface hides of them is dashed, as in technical drawings. */

import { AlwaysDepth, BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Group, LessEqualDepth, Mesh, ShaderMaterial, Vector2, Vector3 } from "three";
import type { Label } from "./overlay";
import { srgb } from "./plain";
import type { Vec3 } from "./world";

export interface Ruler {
  /** World units; a line leads from each to the next, none if there is one point alone. */
  readonly points: readonly Vec3[];
  /** May be empty. */
  readonly text: string;
  /** Position of the text; it stands `raised` pixels of the page above that. */
  readonly at: Vec3;
  readonly raised: number;
}

/** Pixels of the page. */
const WIDTH = 2;
const OUTLINE = 4;
const COLOR = "#10161d";
/** Length of a dash, and of the gap after it. */
const DASH = 4;

const VERTEX = /* glsl */ `
uniform vec2 size;  // of the picture, in pixels of the page
uniform float width;
uniform float forward;
in vec3 other;
in float side;
in float end;        // 0 at the one end, 1 at the other
out vec2 along;      // from the one end in pixels, times w; w: what lies between is then linear on screen
void main() {
  mat4 m = projectionMatrix * modelViewMatrix;
  vec4 a = m * vec4(position, 1.0);
  vec4 b = m * vec4(other, 1.0);
  // An end behind the camera is moved along the line to just before it.
  float front = 1e-4;
  if (a.w < front && b.w > front) a = mix(a, b, (front - a.w) / (b.w - a.w));
  if (b.w < front && a.w > front) b = mix(b, a, (front - b.w) / (a.w - b.w));
  vec2 line = 0.5 * (b.xy / b.w - a.xy / a.w) * size;
  vec2 across = dot(line, line) > 0.0 ? normalize(vec2(-line.y, line.x)) : vec2(0.0);
  gl_Position = a;
  gl_Position.xy += side * width * across / size * a.w;
  // A line along the surface lies half behind it.
  gl_Position.z -= forward * a.w;
  along = a.w * vec2(end * length(line), 1.0);
}
`;

const FRAGMENT = /* glsl */ `
uniform vec3 plain;
uniform float gap;   // of dashes; 0: none
in vec2 along;
out vec4 color;
void main() {
  if (gap > 0.0 && mod(along.x / along.y, 2.0 * gap) > gap) discard;
  color = vec4(plain, 1.0);
}
`;

export class Rulers {
  readonly object = new Group();
  private shown: readonly Ruler[] = [];
  private geometry = new BufferGeometry();
  private readonly size = { value: new Vector2(1, 1) };
  private readonly meshes: readonly Mesh[];

  constructor() {
    this.meshes = [
      this.layer(0, "#ffffff", OUTLINE, true),
      this.layer(1, COLOR, WIDTH, true),
      this.layer(2, "#ffffff", OUTLINE, false),
      this.layer(3, COLOR, WIDTH, false),
    ];
  }

  set(rulers: readonly Ruler[]): void {
    this.shown = rulers;
    this.geometry.dispose();
    this.geometry = lines(rulers.flatMap(({ points }) => points.slice(1).map((to, i) => [points[i] ?? to, to] as const)));
    this.object.clear();
    if (rulers.every(({ points }) => points.length < 2)) return;
    for (const mesh of this.meshes) mesh.geometry = this.geometry;
    this.object.add(...this.meshes);
  }

  /** Of the picture, in pixels of the page. */
  resize(width: number, height: number): void {
    this.size.value.set(width, height);
  }

  get labels(): Label[] {
    return this.shown.filter(({ text }) => text !== "").map(({ text, at, raised }) => ({ text, at: new Vector3(...at), raised, isOnSurface: true }));
  }

  private layer(order: number, style: string, width: number, isHidden: boolean): Mesh {
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: { size: this.size, width: { value: width }, forward: { value: isHidden ? 0 : 0.004 }, plain: { value: srgb(style) }, gap: { value: isHidden ? DASH : 0 } },
      side: DoubleSide,
      depthFunc: isHidden ? AlwaysDepth : LessEqualDepth,
      depthWrite: false,
    });
    const mesh = new Mesh(this.geometry, material);
    mesh.frustumCulled = false;
    // Below the dots at their ends.
    mesh.renderOrder = 10 + order;
    return mesh;
  }
}

/** Two triangles a line: each of their corners knows the other end, and to which side of the line it goes. */
function lines(pairs: readonly (readonly [Vec3, Vec3])[]): BufferGeometry {
  const corners = pairs.flatMap(([a, b]) => [[a, b, 1, 0], [a, b, -1, 0], [b, a, 1, 1], [b, a, -1, 1]] as const);
  // Seen from its other end a line's left is its right.
  const indices = pairs.flatMap((_, i) => [0, 1, 2, 0, 2, 3].map((corner) => 4 * i + corner));
  const geometry = new BufferGeometry();
  const attribute = (name: string, numbers: readonly number[], count: number) => geometry.setAttribute(name, new BufferAttribute(new Float32Array(numbers), count));
  attribute("position", corners.flatMap(([at]) => at), 3);
  attribute("other", corners.flatMap(([, other]) => other), 3);
  attribute("side", corners.map(([, , side]) => side), 1);
  attribute("end", corners.map(([, , , end]) => end), 1);
  geometry.setIndex(indices);
  return geometry;
}
