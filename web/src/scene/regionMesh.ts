/** The mesh of one region on the GPU. */

import {
  BufferAttribute,
  BufferGeometry,
  InterleavedBuffer,
  InterleavedBufferAttribute,
  Matrix4,
  Mesh,
  Sphere,
  Vector3,
  type Material,
} from "three";
import type { Uneven } from "../world/uneven";
import { inEvenCoordinates, type Mesher } from "./unevenMesh";
import { NO_VALUE } from "./shaders";
import type { Vec3 } from "./world";

/** A region mesh as typed arrays; `upload` takes ownership of them. */
export interface RegionMeshData {
  /**
   * Interleaved, six 16-bit words a vertex: position x, y, z, signed; packed octahedral normal; s and normalised feature,
   * unsigned (one attribute array has one type: the shader converts these three).
   */
  readonly vertices: Int16Array<ArrayBuffer>;
  /** Three per triangle, triangles ordered by level, finest first. */
  readonly indices: Uint16Array<ArrayBuffer> | Uint32Array<ArrayBuffer>;
  /** The value of a field at each vertex, NaN if it is missing. */
  readonly values?: Float32Array<ArrayBuffer> | undefined;
  /** Triangles of each level, finest first. */
  readonly levelTriangles: readonly number[];
  /** Index coordinates of position 0. */
  readonly corner: Vec3;
  /** Position units per index step. */
  readonly lattice: number;
  /** Which mesher made it. */
  readonly mesher: Mesher;
  /** Number of the surface that it is a part of. */
  readonly surface: number;
  /** In index space; of the mesh in even coordinates. */
  readonly bounds: { readonly min: Vec3; readonly max: Vec3 };
}

const WORDS_PER_VERTEX = 6;

/** Of the last word of each vertex, which is unsigned. */
function spanOf(words: Int16Array): readonly [number, number] {
  let [low, high] = [65535, 0];
  for (let i = WORDS_PER_VERTEX - 1; i < words.length; i += WORDS_PER_VERTEX) {
    const word = (words[i] ?? 0) & 65535;
    low = Math.min(low, word);
    high = Math.max(high, word);
  }
  return [low / 65535, high / 65535];
}

/** Of the values that there are; the others become `NO_VALUE`, as a shader cannot test for NaN. */
function valueSpanOf(values: Float32Array): readonly [number, number] | undefined {
  let [low, high] = [Infinity, -Infinity];
  values.forEach((value, i) => {
    if (Number.isNaN(value)) values[i] = NO_VALUE;
    else [low, high] = [Math.min(low, value), Math.max(high, value)];
  });
  return low <= high ? [low, high] : undefined;
}

export class RegionMesh {
  readonly levelTriangles: readonly number[];
  readonly bounds: RegionMeshData["bounds"];
  readonly surface: number;
  readonly vertexCount: number;
  /** The minimum and the maximum of the feature of its vertices, 0 to 1. */
  readonly featureSpan: readonly [number, number];
  /** The minimum and the maximum of the field's values; `undefined` if there are none. */
  readonly valueSpan: readonly [number, number] | undefined;
  readonly bytes: number;
  private readonly geometry: BufferGeometry;
  private readonly mesh: Mesh;
  private wire: Mesh | undefined;
  private values: BufferAttribute | undefined;

  /** @param uneven axes of the grid whose samples are not at even distances */
  constructor(data: RegionMeshData, material: Material, uneven?: Uneven) {
    const moved = uneven === undefined ? undefined : inEvenCoordinates(data, uneven);
    this.levelTriangles = data.levelTriangles;
    this.bounds = moved?.bounds ?? data.bounds;
    this.surface = data.surface;
    this.vertexCount = data.vertices.length / WORDS_PER_VERTEX;
    this.featureSpan = spanOf(data.vertices);
    this.valueSpan = data.values && valueSpanOf(data.values);
    this.bytes = data.vertices.byteLength + data.indices.byteLength + (data.values?.byteLength ?? 0) + (moved?.positions.byteLength ?? 0);

    const words = new InterleavedBuffer(data.vertices, WORDS_PER_VERTEX);
    // Free the host's copy; after a lost context the server sends the mesh again.
    words.onUpload(() => {
      words.array = new Int16Array(0);
    });
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", moved === undefined ? new InterleavedBufferAttribute(words, 3, 0, false) : new BufferAttribute(moved.positions, 3));
    geometry.setAttribute("packedNormal", new InterleavedBufferAttribute(words, 1, 3, false));
    geometry.setAttribute("features", new InterleavedBufferAttribute(words, 2, 4, false));
    if (data.values !== undefined) geometry.setAttribute("fieldValue", new BufferAttribute(data.values, 1));
    geometry.setIndex(new BufferAttribute(data.indices, 1));
    let start = 0;
    data.levelTriangles.forEach((triangles, level) => {
      if (triangles > 0) geometry.addGroup(start, 3 * triangles, level);
      start += 3 * triangles;
    });

    const { corner, lattice }: Pick<RegionMeshData, "corner" | "lattice"> = moved === undefined ? data : { corner: [0, 0, 0], lattice: 1 };
    const { bounds } = this;
    const matrix = new Matrix4().makeTranslation(...corner).scale(new Vector3().setScalar(1 / lattice));
    const local = (p: Vec3) => new Vector3(p[0] - corner[0], p[1] - corner[1], p[2] - corner[2]).multiplyScalar(lattice);
    const [min, max] = [local(bounds.min), local(bounds.max)];
    geometry.boundingSphere = new Sphere(min.clone().add(max).multiplyScalar(0.5), min.distanceTo(max) / 2);

    this.geometry = geometry;
    this.mesh = new Mesh(geometry, material);
    this.mesh.matrixAutoUpdate = false;
    this.mesh.matrix.copy(matrix);
  }

  get object(): Mesh {
    return this.mesh;
  }

  set material(material: Material | Material[]) {
    this.mesh.material = material;
  }

  /** Shows only triangles of this level and coarser ones. */
  set finestLevel(level: number) {
    const hidden = this.levelTriangles.slice(0, level).reduce((sum, n) => sum + n, 0);
    this.geometry.setDrawRange(3 * hidden, Infinity);
  }

  /**
   * A value of each vertex, for colour.
   * @throws when there are not as many as vertices
   */
  setValues(values: Float32Array<ArrayBuffer>): void {
    if (values.length !== this.vertexCount) {
      throw new Error(`${values.length} values for a region mesh, expected one for each of its ${this.vertexCount} vertices`);
    }
    if (this.values === undefined) {
      this.values = new BufferAttribute(values, 1);
      this.geometry.setAttribute("value", this.values);
    } else {
      // Reuses the buffer on the GPU: another attribute would leak the first one there.
      this.values.copyArray(values).needsUpdate = true;
    }
  }

  /** Shows nothing, but rendering still uploads the mesh. */
  hideAll(): void {
    this.geometry.setDrawRange(0, 0);
  }

  /** Shows the triangles' edges in this material; `undefined`: no edges. */
  setWire(material: Material | undefined): void {
    if (this.wire !== undefined) this.mesh.remove(this.wire);
    this.wire = undefined;
    if (material === undefined) return;
    this.wire = new Mesh(this.geometry, material);
    this.wire.matrixAutoUpdate = false;
    this.mesh.add(this.wire);
  }

  set edgesVisible(visible: boolean) {
    if (this.wire !== undefined) this.wire.visible = visible;
  }

  dispose(): void {
    this.mesh.removeFromParent();
    this.geometry.dispose();
  }
}
