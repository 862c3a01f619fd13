/**
 * The map from region to mesh of one surface, as a reducer. It holds the ids of chunks, no bytes or meshes, and does no I/O: each event
 * returns the actions for its caller.
 *
 * A chunk is *received* (it has an id), *resident* (decoded and uploaded), *shown*, and in the end *dropped*.
 * The chunks of a prefix are one change to the map. It takes effect as a whole, when the server has committed the prefix
 * and all its chunks are resident; until then the old surface is shown.
 *
 * A committed prefix must be kept even if a newer generation begins before it is shown: the server assumes that this client
 * holds it, and sends only later changes. Such prefixes of an ended generation collapse into one change, and chunks that a
 * later prefix replaces are dropped undecoded.
 */

/** Names one received chunk; unique while the page lives. */
export type ChunkId = number;
/** `"a,b,c,s"`: coordinates and size of a region. */
export type RegionKey = string;

/** A prefix that is not shown yet. */
interface PendingPrefix {
  generation: number;
  level: number;
  /** The final surface of its generation. */
  final: boolean;
  /** Chunks the server announced. */
  readonly regions: number;
  /** The server said `committed`. */
  committed: boolean;
  /** A chunk replaces the region's mesh, `null` removes it. */
  readonly changes: Map<RegionKey, ChunkId | null>;
  /** Chunks in `changes` that are not resident yet. */
  readonly missing: Set<ChunkId>;
  /** The whole surface: regions that are shown and not in `changes` are removed. */
  readonly whole: boolean;
}

export type RegionEvent =
  | {
      readonly type: "prefix";
      readonly generation: number;
      readonly level: number;
      readonly regions: number;
      /** Whether it is the final surface of its generation. */
      readonly final: boolean;
    }
  | {
      readonly type: "chunk";
      readonly generation: number;
      readonly level: number;
      readonly region: RegionKey;
      /** `null`: the region has no surface any more. */
      readonly id: ChunkId | null;
    }
  | { readonly type: "committed"; readonly generation: number; readonly level: number }
  | { readonly type: "superseded"; readonly generation: number }
  | { readonly type: "resident"; readonly id: ChunkId }
  /** The server assumes that this client holds nothing: a new connection, another volume. The surface on screen remains. */
  | { readonly type: "reset" };

/** A prefix to show at once. */
export interface Swap {
  readonly generation: number;
  readonly level: number;
  readonly final: boolean;
  readonly show: readonly ChunkId[];
  readonly remove: readonly ChunkId[];
}

export interface Effects {
  /** To show, in order. */
  readonly swaps: readonly Swap[];
  /** Chunks that will never be shown: forget their bytes and meshes, and do not decode them. */
  readonly dropped: readonly ChunkId[];
}

/** The server did something the protocol does not allow. */
export class SequenceError extends Error {
  override readonly name = "SequenceError";
}

/** State of the map; changed by `reduce` alone. */
export interface RegionMap {
  /** The regions on screen. */
  readonly shown: Map<RegionKey, ChunkId>;
  /** Oldest first; only the last may be uncommitted. */
  readonly pending: PendingPrefix[];
  /** The prefix that each chunk is missing in. */
  readonly prefixOf: Map<ChunkId, PendingPrefix>;
  /** Nothing was committed since the last reset. */
  fresh: boolean;
}

export function emptyMap(): RegionMap {
  return { shown: new Map(), pending: [], prefixOf: new Map(), fresh: true };
}

/**
 * Applies one event.
 * @throws SequenceError when the server left the order of section 3 of PROTOCOL.md; start over with `reset` and a new connection
 */
export function reduce(map: RegionMap, event: RegionEvent): Effects {
  const dropped: ChunkId[] = [];
  switch (event.type) {
    case "prefix":
      beginPrefix(map, event, dropped);
      break;
    case "chunk":
      addChunk(map, event);
      break;
    case "committed":
      commit(map, event);
      break;
    case "superseded":
      if ((map.pending.at(-1)?.generation ?? Infinity) <= event.generation) endGeneration(map, dropped);
      break;
    case "resident":
      // Unknown when it was dropped while it was uploaded.
      map.prefixOf.get(event.id)?.missing.delete(event.id);
      map.prefixOf.delete(event.id);
      break;
    case "reset":
      for (const prefix of map.pending) dropChanges(map, prefix, dropped);
      map.pending.length = 0;
      map.fresh = true;
      break;
  }
  return { swaps: takeReady(map), dropped };
}

/** The chunk of a region that the server takes this client to hold: the last that was committed, whether or not it is shown yet. */
export function heldChunk(map: RegionMap, region: RegionKey): ChunkId | undefined {
  if (map.fresh) return undefined;
  for (const { committed, changes, whole } of map.pending.toReversed()) {
    const change = committed ? changes.get(region) : undefined;
    if (change !== undefined) return change ?? undefined;
    if (committed && whole) return undefined;
  }
  return map.shown.get(region);
}

/** Whether everything that was announced is on screen. */
export function isSettled(map: RegionMap): boolean {
  return map.pending.length === 0;
}

type EventOf<T extends RegionEvent["type"]> = Extract<RegionEvent, { type: T }>;

function beginPrefix(map: RegionMap, { generation, level, regions, final }: EventOf<"prefix">, dropped: ChunkId[]): void {
  if (openPrefix(map)?.generation === generation) {
    throw new SequenceError(`prefix ${level} begins before the one before it was committed`);
  }
  if ((map.pending.at(-1)?.generation ?? generation) !== generation) endGeneration(map, dropped);
  map.pending.push({
    generation,
    level,
    final,
    regions,
    committed: false,
    changes: new Map(),
    missing: new Set(),
    whole: map.fresh,
  });
}

function addChunk(map: RegionMap, { generation, level, region, id }: EventOf<"chunk">): void {
  const prefix = openPrefix(map);
  if (prefix?.generation !== generation || prefix.level !== level) {
    throw new SequenceError(`chunk of generation ${generation}, level ${level} outside its prefix`);
  }
  if (prefix.changes.has(region)) throw new SequenceError(`region (${region}) twice in one prefix`);
  if (prefix.changes.size >= prefix.regions) {
    throw new SequenceError(`more than the ${prefix.regions} chunks that prefix ${prefix.level} announced`);
  }
  prefix.changes.set(region, id);
  if (id === null) return;
  prefix.missing.add(id);
  map.prefixOf.set(id, prefix);
}

function commit(map: RegionMap, { generation, level }: EventOf<"committed">): void {
  const prefix = openPrefix(map);
  if (prefix?.generation !== generation || prefix.level !== level) {
    throw new SequenceError(`prefix ${level} of generation ${generation} committed, but never begun`);
  }
  if (prefix.changes.size !== prefix.regions) {
    throw new SequenceError(`prefix ${level} committed after ${prefix.changes.size} of ${prefix.regions} chunks`);
  }
  prefix.committed = true;
  map.fresh = false;
}

function openPrefix(map: RegionMap): PendingPrefix | undefined {
  const last = map.pending.at(-1);
  return last?.committed === false ? last : undefined;
}

/** No more frames of this generation: forgets its open prefix and folds the committed ones into one change. */
function endGeneration(map: RegionMap, dropped: ChunkId[]): void {
  const open = openPrefix(map);
  if (open !== undefined) {
    dropChanges(map, open, dropped);
    map.pending.pop();
  }
  const [first, ...rest] = map.pending;
  if (first === undefined) return;
  for (const later of rest) {
    for (const [region, id] of later.changes) {
      const earlier = first.changes.get(region);
      if (typeof earlier === "number") {
        first.missing.delete(earlier);
        map.prefixOf.delete(earlier);
        dropped.push(earlier);
      }
      first.changes.set(region, id);
    }
    for (const id of later.missing) {
      first.missing.add(id);
      map.prefixOf.set(id, first);
    }
    first.generation = later.generation;
    first.level = later.level;
    first.final = later.final;
  }
  map.pending.length = 1;
}

/** Moves committed prefixes whose chunks are all resident from `pending` to `shown`. */
function takeReady(map: RegionMap): Swap[] {
  const swaps: Swap[] = [];
  for (;;) {
    const prefix = map.pending[0];
    if (prefix?.committed !== true || prefix.missing.size > 0) return swaps;
    map.pending.shift();
    const show: ChunkId[] = [];
    const remove: ChunkId[] = [];
    if (prefix.whole) {
      remove.push(...map.shown.values());
      map.shown.clear();
    }
    for (const [region, id] of prefix.changes) {
      const old = map.shown.get(region);
      if (old !== undefined) remove.push(old);
      if (id === null) {
        map.shown.delete(region);
      } else {
        map.shown.set(region, id);
        show.push(id);
      }
    }
    const { generation, level, final } = prefix;
    swaps.push({ generation, level, final, show, remove });
  }
}

function dropChanges(map: RegionMap, prefix: PendingPrefix, dropped: ChunkId[]): void {
  for (const id of prefix.changes.values()) {
    if (id === null) continue;
    map.prefixOf.delete(id);
    dropped.push(id);
  }
}
