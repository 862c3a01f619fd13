/** The region maps of all surfaces of a connection, as a reducer over `map.ts`. */

import { emptyMap, isSettled, reduce, type ChunkId, type RegionEvent, type RegionMap, type Swap } from "./map";

type Shared = Extract<RegionEvent, { readonly type: "resident" | "reset" }>;

export type SurfaceEvent =
  | (Exclude<RegionEvent, Shared> & { readonly surface: number })
  | Shared
  /** The server has removed a surface: its shown and pending chunks are dropped. */
  | { readonly type: "removed"; readonly surface: number };

/** A prefix of a surface to show at once. */
export type SurfaceSwap = Swap & { readonly surface: number };

export interface SurfaceEffects {
  /** To show, in order. */
  readonly swaps: readonly SurfaceSwap[];
  /** Shown chunks of a surface that was removed. */
  readonly removed: readonly ChunkId[];
  /** Chunks that will never be shown. */
  readonly dropped: readonly ChunkId[];
}

/** By the numbers of the surfaces; changed by `reduceSurfaces` alone. */
export type SurfaceMaps = Map<number, RegionMap>;

/**
 * Applies one event to the surface that it names, or to all.
 * @throws SequenceError as `reduce`
 */
export function reduceSurfaces(maps: SurfaceMaps, event: SurfaceEvent): SurfaceEffects {
  switch (event.type) {
    case "removed":
      return remove(maps, event.surface);
    case "reset":
    case "resident":
      return joined([...maps].map(([surface, map]) => ofSurface(surface, map, event)));
    case "prefix":
    case "chunk":
    case "committed":
    case "superseded": {
      const map = maps.get(event.surface) ?? emptyMap();
      maps.set(event.surface, map);
      return ofSurface(event.surface, map, event);
    }
  }
}

/** Whether everything that was announced is on screen. */
export function areSettled(maps: SurfaceMaps): boolean {
  return [...maps.values()].every(isSettled);
}

function ofSurface(surface: number, map: RegionMap, event: RegionEvent): SurfaceEffects {
  const { swaps, dropped } = reduce(map, event);
  return { swaps: swaps.map((swap) => ({ surface, ...swap })), removed: [], dropped };
}

function joined(all: readonly SurfaceEffects[]): SurfaceEffects {
  return {
    swaps: all.flatMap(({ swaps }) => swaps),
    removed: all.flatMap(({ removed }) => removed),
    dropped: all.flatMap(({ dropped }) => dropped),
  };
}

function remove(maps: SurfaceMaps, surface: number): SurfaceEffects {
  const map = maps.get(surface);
  if (map === undefined) return { swaps: [], removed: [], dropped: [] };
  const { dropped } = reduce(map, { type: "reset" });
  maps.delete(surface);
  return { swaps: [], removed: [...map.shown.values()], dropped };
}
