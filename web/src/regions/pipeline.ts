/** From binary frames to the screen: header check, region maps, decoding, upload, swap. */

import type { DecodedChunk } from "../decode/decode";
import { readDistances } from "../decode/distances";
import type { MeshSums, WorldAxes } from "../decode/meshSums";
import { DecodeQueue, type DecodeWorker } from "../decode/queue";
import { readChunkHeader, type ChunkHeader } from "../protocol/chunk";
import { REGION_CELLS } from "../protocol/generated";
import type { RegionMeshData } from "../scene/regionMesh";
import type { Annotated, View } from "../protocol/types";
import type { Uneven } from "../world/uneven";
import { Annotations, type Annotation } from "./annotations";
import { heldChunk, type ChunkId, type RegionKey } from "./map";
import { areSettled, reduceSurfaces, type SurfaceEffects, type SurfaceEvent, type SurfaceMaps, type SurfaceSwap } from "./surfaces";

/** The part of the scene that the pipeline uses. */
export interface RegionScene {
  /** `surface`: the number of the surface that the mesh is of. */
  upload(id: ChunkId, data: RegionMeshData, surface: number): void;
  swap(show: readonly ChunkId[], remove: readonly ChunkId[]): void;
  drop(ids: readonly ChunkId[]): void;
  /** A value of each vertex of a mesh on screen. */
  setValues(id: ChunkId, values: Float32Array<ArrayBuffer>): void;
  clear(): void;
}

type Prefix = Extract<SurfaceEvent, { readonly type: "prefix" }>;
/** An event of the region maps; a prefix says which mesher made its chunks. */
export type PipelineEvent = Exclude<SurfaceEvent, Prefix> | (Prefix & { readonly mesher: View["mesher"] });

/** A chunk between its arrival and its upload to the GPU. */
interface Arriving {
  readonly header: ChunkHeader;
  readonly mesher: View["mesher"];
}

export interface PipelineHandlers {
  /** A prefix is shown. */
  readonly onSwap: (swap: SurfaceSwap) => void;
  /** The meshes have the server's values of each vertex. */
  readonly onAnnotated: (annotation: Annotation) => void;
  /** The server or a chunk broke the protocol: start over with a `reset` and a new connection. */
  readonly onBroken: (reason: string) => void;
}

const keyOf = ({ region, size }: ChunkHeader): RegionKey => [...region, size].join();

export class RegionPipeline {
  private readonly maps: SurfaceMaps = new Map();
  /** Chunks that are not resident yet. */
  private readonly arriving = new Map<ChunkId, Arriving>();
  /** By the number of a surface, of the chunks that come. */
  private readonly meshers = new Map<number, View["mesher"]>();
  private readonly queue: DecodeQueue;
  private readonly annotations: Annotations;
  private lastId: ChunkId = 0;

  constructor(
    worker: DecodeWorker,
    private readonly scene: RegionScene,
    private readonly handlers: PipelineHandlers,
  ) {
    this.queue = new DecodeQueue(
      worker,
      (id, chunk) => this.decoded(id, chunk),
      (reason) => this.handlers.onBroken(reason),
    );
    this.annotations = new Annotations(
      (id, values) => this.giveValues(id, values),
      (annotation) => this.handlers.onAnnotated(annotation),
    );
  }

  /** Chunks received, but not decoded yet. */
  get undecoded(): number {
    return this.queue.size;
  }

  /** Whether everything that was announced is shown. */
  get settled(): boolean {
    return areSettled(this.maps);
  }

  /** A binary frame of the open volume. */
  chunk(frame: ArrayBuffer): void {
    let header: ChunkHeader;
    try {
      header = readChunkHeader(frame);
      if (header.kind === "error") return this.annotate(header, frame);
    } catch (error) {
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
      return;
    }
    const { surface, generation, level, vertexCount } = header;
    const id = vertexCount === 0 ? null : ++this.lastId;
    if (!this.event({ type: "chunk", surface, generation, level, region: keyOf(header), id }) || id === null) return;
    // Always defined here: `event` has refused a chunk outside a prefix.
    const mesher = this.meshers.get(surface);
    if (mesher === undefined) return;
    this.arriving.set(id, { header, mesher });
    this.queue.push(id, frame);
  }

  /** An annotation begins: its chunks follow. */
  annotated(announced: Annotated): void {
    this.annotations.begin(announced);
  }

  /** A message about prefixes, or `reset`. `false` when it came out of order. */
  event(event: PipelineEvent): boolean {
    let effects: SurfaceEffects;
    try {
      effects = reduceSurfaces(this.maps, event);
    } catch (error) {
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
      return false;
    }
    if (event.type === "prefix") this.meshers.set(event.surface, event.mesher);
    this.queue.drop([...effects.dropped, ...effects.removed, ...effects.swaps.flatMap(({ remove }) => remove)]);
    this.scene.drop(effects.dropped);
    for (const id of effects.dropped) this.arriving.delete(id);
    if (event.type === "reset") this.annotations.reset();
    if (effects.removed.length > 0) this.scene.swap([], effects.removed);
    for (const swap of effects.swaps) {
      this.scene.swap(swap.show, swap.remove);
      this.handlers.onSwap(swap);
      this.annotations.shown(swap.show);
    }
    this.annotations.dropped(effects.dropped);
    return true;
  }

  /** Removes surfaces of other numbers. */
  keep(numbers: readonly number[]): void {
    for (const surface of [...this.maps.keys()]) if (!numbers.includes(surface)) this.event({ type: "removed", surface });
  }

  /** A region mesh is on the GPU. */
  resident(id: ChunkId): void {
    this.arriving.delete(id);
    this.event({ type: "resident", id });
  }

  /**
   * Area and volume of a surface as it is on screen.
   * @param axes world vectors of a step along each axis of the index space
   */
  sum(surface: number, axes: WorldAxes, uneven?: Uneven): Promise<MeshSums> {
    return this.queue.sum([...(this.maps.get(surface)?.shown.values() ?? [])], axes, uneven);
  }

  /** Forgets the surface on screen too: for another volume, or after the GPU lost it. */
  clear(): void {
    this.event({ type: "reset" });
    this.queue.drop([...this.maps.values()].flatMap(({ shown }) => [...shown.values()]));
    this.maps.clear();
    this.arriving.clear();
    this.meshers.clear();
    this.scene.clear();
  }

  /** @throws when the chunk is damaged, or has no place */
  private annotate(header: ChunkHeader, frame: ArrayBuffer): void {
    const { surface, generation } = header;
    const key = keyOf(header);
    const values = readDistances(header, frame);
    const map = this.maps.get(surface);
    const id = map && heldChunk(map, key);
    this.annotations.add({ surface, generation, values }, id, id !== undefined && map?.shown.get(key) === id);
  }

  private giveValues(id: ChunkId, values: Float32Array<ArrayBuffer>): void {
    try {
      this.scene.setValues(id, values);
    } catch (error) {
      // Not as many as the mesh has vertices.
      this.handlers.onBroken(error instanceof Error ? error.message : String(error));
    }
  }

  private decoded(id: ChunkId, chunk: DecodedChunk): void {
    const arriving = this.arriving.get(id);
    if (arriving === undefined) return;
    const { header, mesher } = arriving;
    const [a, b, c] = header.region;
    const data = {
      vertices: chunk.vertices,
      indices: chunk.indices,
      values: chunk.values,
      levelTriangles: header.levelTriangles,
      corner: [a * REGION_CELLS, b * REGION_CELLS, c * REGION_CELLS] as const,
      lattice: header.lattice,
      mesher,
      surface: header.surface,
      bounds: header.bounds,
    };
    this.scene.upload(id, data, header.surface);
  }
}
