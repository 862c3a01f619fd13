/**
 * Annotations: a number of each vertex of the meshes that the server takes this client to hold. The meshes are in order of arrival decoded
 * and uploaded, so a number may come before its mesh is on screen; it waits until then.
 */

import type { Annotated } from "../protocol/types";
import { SequenceError, type ChunkId } from "./map";

/** A complete annotation. */
export interface Annotation {
  readonly surface: number;
  readonly generation: number;
  /** Of each region, in the order of its vertices. */
  readonly values: readonly Float32Array<ArrayBuffer>[];
}

/** The surface and generation of one chunk of an annotation, with its values. */
interface Part {
  readonly surface: number;
  readonly generation: number;
  readonly values: Float32Array<ArrayBuffer>;
}

export class Annotations {
  /** The annotation that is being received. */
  private open: { readonly announced: Annotated; came: number; readonly values: Float32Array<ArrayBuffer>[] } | undefined;
  /** Values of meshes that are not shown yet. */
  private readonly waiting = new Map<ChunkId, Float32Array<ArrayBuffer>>();

  /**
   * @param give hands its values to a mesh on screen
   * @param onComplete an annotation is complete, and its meshes are on screen
   */
  constructor(
    private readonly give: (id: ChunkId, values: Float32Array<ArrayBuffer>) => void,
    private readonly onComplete: (annotation: Annotation) => void,
  ) {}

  begin(announced: Annotated): void {
    this.open = { announced, came: 0, values: [] };
    this.finish();
  }

  /**
   * @param id the mesh of the region; `undefined`: this client has none, because it lost its graphics device meanwhile
   * @throws SequenceError if no annotation was announced that it could be a part of
   */
  add({ surface, generation, values }: Part, id: ChunkId | undefined, isShown: boolean): void {
    const { open } = this;
    if (open?.announced.surface !== surface || open.announced.generation !== generation || open.came >= open.announced.regions) {
      throw new SequenceError(`chunk of an annotation of generation ${generation} that was not announced`);
    }
    open.came += 1;
    if (id !== undefined) {
      open.values.push(values);
      if (isShown) this.give(id, values);
      else this.waiting.set(id, values);
    }
    this.finish();
  }

  /** These meshes are on screen now. */
  shown(ids: readonly ChunkId[]): void {
    if (this.waiting.size === 0) return;
    for (const id of ids) {
      const values = this.waiting.get(id);
      if (values !== undefined) this.give(id, values);
    }
    this.dropped(ids);
  }

  /** These meshes will never be on screen. */
  dropped(ids: readonly ChunkId[]): void {
    let isLess = false;
    for (const id of ids) isLess = this.waiting.delete(id) || isLess;
    if (isLess) this.finish();
  }

  /** The server does not answer earlier questions any more. */
  reset(): void {
    this.open = undefined;
    this.waiting.clear();
  }

  private finish(): void {
    const { open } = this;
    if (open === undefined || open.came < open.announced.regions || this.waiting.size > 0) return;
    this.open = undefined;
    const { surface, generation } = open.announced;
    this.onComplete({ surface, generation, values: open.values });
  }
}
