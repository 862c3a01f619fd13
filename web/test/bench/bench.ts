/** A page with the scene alone and spheres to look at, for tests of its pixels (tests/browser/scene.test.mjs). */

import { COLOR_MAPS, colorTable } from "../../src/colors/maps";
import { composeImage } from "../../src/image/compose";
import { makeTurntable } from "../../src/image/turntable";
import { SurfaceRenderer } from "../../src/scene/renderer";
import { LEVEL_COLORS, rampLut } from "../../src/transfer/lut";
import { octahedral } from "../synthetic";

const LATTICE = 512;
/** Index space reaches from 0 to `SIZE` on each axis; its middle is the world's origin. */
const SIZE = 60;

interface Sphere {
  readonly surface?: number;
  readonly radius: number;
  readonly center?: readonly [number, number, number];
  /** Share of the height at which it is cut off and open, as a surface at the volume's border. */
  readonly top?: number;
  readonly segments?: number;
}

let resolveResident: (() => void) | undefined;
const scene = new SurfaceRenderer(
  document.getElementById("stage") ?? document.body,
  { transfer: rampLut(["#ff0000", "#0000ff"]), importance: rampLut(["#000000", "#ffffff"]), levels: LEVEL_COLORS },
  { onResident: () => resolveResident?.(), onFrame: () => undefined, onContextLost: () => undefined, onContextRestored: () => undefined },
);
scene.setGrid({
  origin: [-SIZE / 2, -SIZE / 2, -SIZE / 2],
  spacing: [1, 1, 1],
  direction: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  dims: [SIZE + 1, SIZE + 1, SIZE + 1],
});

let lastId = 0;

/** Adds a sphere and returns its id. */
async function addSphere({ surface = 0, radius, center = [0, 0, 0], top = 1, segments = 96 }: Sphere): Promise<number> {
  const rows = segments / 2;
  const vertices = new Int16Array(6 * (rows + 1) * (segments + 1));
  const bytes = new Uint8Array(vertices.buffer);
  const words = new Uint16Array(vertices.buffer);
  const indices: number[] = [];
  for (let row = 0; row <= rows; row += 1) {
    // From the south pole up.
    const polar = Math.PI - (row / rows) * (Math.PI - Math.acos(2 * top - 1));
    for (let column = 0; column <= segments; column += 1) {
      const azimuth = (2 * Math.PI * column) / segments;
      const n = [Math.sin(polar) * Math.cos(azimuth), Math.sin(polar) * Math.sin(azimuth), Math.cos(polar)] as const;
      const v = row * (segments + 1) + column;
      n.forEach((c, axis) => (vertices[6 * v + axis] = Math.round(LATTICE * (SIZE / 2 + (center[axis] ?? 0) + radius * c))));
      bytes.set(octahedral([...n]), 12 * v + 6);
      words.set([(65535 * row) / rows, (65535 * row) / rows], 6 * v + 4);
      if (row === rows || column === segments) continue;
      indices.push(v, v + 1, v + segments + 2, v, v + segments + 2, v + segments + 1);
    }
  }
  const [min, max] = [-1, 1].map((sign) => center.map((c) => SIZE / 2 + c + sign * radius) as [number, number, number]);
  if (min === undefined || max === undefined) throw new Error("no bounds");
  lastId += 1;
  const id = lastId;
  const resident = new Promise<void>((resolve) => (resolveResident = resolve));
  scene.upload(id, {
    vertices,
    indices: Uint32Array.from(indices),
    levelTriangles: [indices.length / 3, 0, 0, 0, 0, 0],
    corner: [0, 0, 0],
    lattice: LATTICE,
    mesher: "dual",
    surface,
    bounds: { min, max },
  });
  await resident;
  scene.swap([id], []);
  return id;
}

/** Waits until the camera rests and the last frame is rendered. */
async function still(): Promise<void> {
  for (let quiet = 0, last = -1; quiet < 4; ) {
    await new Promise(requestAnimationFrame);
    quiet = scene.framesRendered === last ? quiet + 1 : 0;
    last = scene.framesRendered;
  }
  await scene.finished();
}

/** The colour of a pixel of the page, as the scene renders it with a snapshot of the same size. */
function pixel(x: number, y: number): number[] {
  const { width, height, pixels } = scene.snapshot({ scale: 1, transparent: true });
  const at = 4 * (Math.floor(y * height) * width + Math.floor(x * width));
  return [...pixels.subarray(at, at + 4)];
}

/** World units across the height of the picture, at the target: the field of view has 32 degrees. */
function heightAtTarget(): number {
  const { position, target } = scene.camera.pose;
  return 2 * Math.tan((16 * Math.PI) / 180) * Math.hypot(...position.map((p, axis) => p - (target[axis] ?? 0)));
}

/** A blob as base64, for what runs the browser. */
async function base64(blob: Blob): Promise<string> {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
}

Object.assign(window, { bench: { scene, addSphere, still, pixel, heightAtTarget, base64, composeImage, makeTurntable, COLOR_MAPS, colorTable } });
