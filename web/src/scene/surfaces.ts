/** The region meshes on screen, by surface; and those of an earlier picture that is compared with. */

import { Box3, Group, type Vector3 } from "three";
import type { ColoredRegion } from "./coloredRegions";
import { MAX_SURFACES, DEFAULT_LOOK, type Look, type SurfaceStyle } from "./look";
import { SharedUniforms, SurfaceMaterials, type ColorTables, type FieldColors, type Pass } from "./material";
import { srgb } from "./plain";
import type { RegionMesh } from "./regionMesh";
import { unevenOf, type Uneven } from "../world/uneven";
import { corners, worldFromGrid, worldFromIndex, type Grid } from "./world";

/** Side of a comparison: the current picture, or the kept one. */
export type Side = "now" | "kept";

export class Surfaces {
  /** Its matrix is the world from index space; its children are the region meshes. */
  readonly root = new Group();
  readonly shared = new SharedUniforms();
  readonly materials: readonly SurfaceMaterials[];
  private readonly shown = new Map<number, RegionMesh>();
  private readonly kept = new Map<number, RegionMesh>();
  private look = DEFAULT_LOOK;
  private finest = 0;
  private readonly gridBox = new Box3();

  constructor(tables: ColorTables) {
    this.root.matrixAutoUpdate = false;
    this.materials = Array.from({ length: MAX_SURFACES }, (_, surface) => new SurfaceMaterials(surface, this.shared, tables));
  }

  /** Region meshes on screen. */
  get count(): number {
    return this.shown.size;
  }

  get hasKept(): boolean {
    return this.kept.size > 0;
  }

  show(id: number, mesh: RegionMesh): void {
    this.shown.set(id, mesh);
    this.applyDisplay(mesh);
    this.root.add(mesh.object);
  }

  remove(id: number): void {
    const mesh = this.shown.get(id);
    this.shown.delete(id);
    if (!this.kept.has(id)) mesh?.dispose();
  }

  /** Keeps what is shown, to compare what follows with it. Until `release` it stays in the GPU's memory. */
  keep(): void {
    this.release();
    for (const [id, mesh] of this.shown) this.kept.set(id, mesh);
  }

  release(): void {
    for (const [id, mesh] of this.kept) if (!this.shown.has(id)) mesh.dispose();
    this.kept.clear();
  }

  clear(): void {
    this.release();
    for (const mesh of this.shown.values()) mesh.dispose();
    this.shown.clear();
  }

  get(id: number): RegionMesh | undefined {
    return this.shown.get(id);
  }

  /** Sets the place of index space in the world; returns the axes that are not even, if there are any. */
  place(grid: Grid): Uneven | undefined {
    this.root.matrix.copy(worldFromIndex(grid));
    this.root.matrixWorldNeedsUpdate = true;
    this.shared.worldFromGrid.value = worldFromGrid(grid);
    this.gridBox.makeEmpty();
    const { dims } = grid;
    const uneven = unevenOf(grid);
    if (dims === undefined) return uneven;
    const last = [dims[0] - 1, dims[1] - 1, dims[2] - 1] as const;
    for (const corner of corners({ min: [0, 0, 0], max: last }, this.root.matrix)) this.gridBox.expandByPoint(corner);
    return uneven;
  }

  /** Bounds of the volume in the world; empty if no grid gives its size. */
  get volumeBox(): Box3 {
    return this.gridBox.clone();
  }

  /** Around all that is shown, in the world. */
  get box(): Box3 {
    const box = new Box3();
    for (const point of this.points()) box.expandByPoint(point);
    return box;
  }

  /** Box around the kept surfaces, in the world. */
  get keptBox(): Box3 {
    const box = new Box3();
    for (const { bounds } of this.kept.values()) for (const point of corners(bounds, this.root.matrix)) box.expandByPoint(point);
    return box;
  }

  /** Corners of the regions' own boxes, which lie closer to a round surface than the box around all. */
  points(): Vector3[] {
    return [...this.shown.values()].flatMap((mesh) => corners(mesh.bounds, this.root.matrix));
  }

  /** Triangles of each level, finest first, of all surfaces and of each. */
  levelSums(): { readonly all: readonly number[]; readonly surfaces: readonly (readonly number[])[] } {
    const surfaces = Array.from({ length: MAX_SURFACES }, () => [0, 0, 0, 0, 0, 0]);
    for (const mesh of this.shown.values()) {
      const sums = surfaces[mesh.surface];
      mesh.levelTriangles.forEach((n, level) => sums !== undefined && (sums[level] = (sums[level] ?? 0) + n));
    }
    return { all: [0, 1, 2, 3, 4, 5].map((level) => surfaces.reduce((sum, of) => sum + (of[level] ?? 0), 0)), surfaces };
  }

  setLook(look: Look): void {
    this.look = look;
    for (const materials of this.materials) materials.setLook(look);
    this.applyDisplayToAll();
  }

  /** Of the triangles' edges. */
  set edgeColor(style: string) {
    this.shared.wireColor.value.copy(srgb(style));
  }

  /** RGBA over the blended feature: colour and importance; and regions that have colours of their own. */
  setTransfer(table: Uint8Array<ArrayBuffer>, surface: number, regions: readonly ColoredRegion[]): void {
    const materials = this.of(surface);
    materials.transfer = table;
    materials.coloredRegions = regions;
    // The programs change if there were no such regions before.
    this.applyDisplayToAll();
  }

  /** What the colours of colour mode `field` stand for. */
  setField(colors: FieldColors, surface: number): void {
    this.of(surface).field = colors;
    this.applyDisplayToAll();
  }

  /**
   * The minimum and the maximum over a surface's vertices: of the feature, 0 to 1, or of the values of the field that they have; `undefined`
   * if there are none.
   */
  span(surface: number, of: "feature" | "values"): readonly [number, number] | undefined {
    const meshes = [...this.shown.values()].filter((mesh) => mesh.surface === surface && mesh.vertexCount > 0);
    const spans = meshes.flatMap(({ featureSpan, valueSpan }) => (of === "feature" ? [featureSpan] : valueSpan === undefined ? [] : [valueSpan]));
    if (spans.length === 0) return undefined;
    return spans.reduce(([low, high], [from, to]) => [Math.min(low, from), Math.max(high, to)]);
  }

  /** Colours of the vertices' values. */
  setValueColors(low: number, high: number, table: Uint8Array<ArrayBuffer>): void {
    this.shared.valueRange.value.set(low, high);
    for (const materials of this.materials) materials.values = table;
  }

  set finestLevel(level: number) {
    this.finest = level;
    this.applyDisplayToAll();
  }

  set clippingPlanes(count: number) {
    for (const materials of this.materials) materials.clippingPlanes = count;
    this.applyDisplayToAll();
  }

  style(surface: number): SurfaceStyle {
    return this.of(surface).style;
  }

  of(surface: number): SurfaceMaterials {
    const materials = this.materials[surface];
    if (materials === undefined) throw new Error(`surface ${surface}, expected 0 to ${MAX_SURFACES - 1}`);
    return materials;
  }

  /** Surfaces that have meshes, are visible and opaque, or translucent. */
  visible(opaque: boolean): number[] {
    const present = new Set([...this.shown.values(), ...this.kept.values()].map(({ surface }) => surface));
    return [...present].sort().filter((surface) => {
      const { visible, opacity } = this.style(surface);
      return visible && opacity > 0 && opacity < 1 !== opaque;
    });
  }

  /** Prepares the meshes for a pass: those of these surfaces on this side are visible, in the pass' material. */
  prepare(pass: Pass, surfaces: readonly number[], side: Side): void {
    const of = this.materials.map((materials) => materials.of(pass));
    const chosen = side === "now" ? this.shown : this.kept;
    for (const mesh of this.allMeshes()) mesh.object.visible = false;
    for (const mesh of chosen.values()) {
      mesh.object.visible = surfaces.includes(mesh.surface);
      mesh.edgesVisible = pass === "opaque";
      mesh.material = of[mesh.surface] ?? [];
    }
  }

  private allMeshes(): Set<RegionMesh> {
    return new Set([...this.shown.values(), ...this.kept.values()]);
  }

  private applyDisplayToAll(): void {
    for (const mesh of this.allMeshes()) this.applyDisplay(mesh);
  }

  private applyDisplay(mesh: RegionMesh): void {
    mesh.object.frustumCulled = true;
    mesh.finestLevel = this.finest;
    mesh.setWire(this.look.wireframe ? this.of(mesh.surface).wire : undefined);
  }
}
