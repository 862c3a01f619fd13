/**
 * The map from region to mesh, as a reducer. It knows ids, not bytes or meshes, and does no I/O: each event returns
 * what its owner has to do.
 *
 * A chunk is *received* (it has an id), *resident* (decoded and uploaded), *shown*, and in the end *dropped*.
 * The chunks of a prefix are one change to the map. It takes effect as a whole, when the prefix was committed by the
 * server and all its chunks are resident; until then the old picture stands.
 *
 * What was committed on the wire must be kept even if a newer generation begins before it is shown: the server takes it
 * as held and sends only what changed since. Such prefixes of an ended generation collapse into one change, and chunks that
 * a later prefix replaces are dropped undecoded.
 */

/** Names one received chunk; unique over the page's life. */
export type ChunkId = number;
/** `"a,b,c"`: region coordinates. */
export type RegionKey = string;

interface Prefix {
  generation: number;
  level: number;
  /** Chunks the server announced. */
  readonly regions: number;
  /** The server said `committed`. */
  committed: boolean;
  /** A id replaces the region's mesh, `null` removes it. */
  readonly changes: Map<RegionKey, ChunkId | null>;
  /** Tickets in `changes` that are not resident yet. */
  readonly missing: Set<ChunkId>;
  /** The whole surface: what is shown and not mentioned goes. */
  readonly whole: boolean;
}

export type RegionEvent =
  | { readonly type: "prefix"; readonly generation: number; readonly level: number; readonly regions: number }
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
  /** The server holds nothing of this client's any more: a fresh connection, another volume. The picture stands. */
  | { readonly type: "reset" };

/** A prefix to show at once. */
export interface Swap {
  readonly generation: number;
  readonly level: number;
  readonly show: readonly ChunkId[];
  readonly remove: readonly ChunkId[];
}

export interface Effects {
  /** To show, in order. */
  readonly swaps: readonly Swap[];
  /** Chunks nobody will show: forget their bytes, meshes and decoding. */
  readonly dropped: readonly ChunkId[];
}

/** The server did something the protocol does not allow. */
export class SequenceError extends Error {
  override readonly name = "SequenceError";
}

/** State of the map; changed by `reduce` alone. */
export interface RegionState {
  /** What is on screen. */
  readonly shown: Map<RegionKey, ChunkId>;
  /** Prefixes under way, oldest first; only the last may be uncommitted. */
  readonly pending: Prefix[];
  /** Which prefix waits for an id. */
  readonly waitedFor: Map<ChunkId, Prefix>;
  /** Nothing was committed since the last reset. */
  fresh: boolean;
}

export function emptyRegions(): RegionState {
  return { shown: new Map(), pending: [], waitedFor: new Map(), fresh: true };
}

/**
 * Applies one event.
 * @throws SequenceError when the server left the order of section 3; start over with `reset` and a new connection
 */
export function reduce(state: RegionState, event: RegionEvent): Effects {
  const dropped: ChunkId[] = [];
  switch (event.type) {
    case "prefix": {
      if (openPrefix(state)?.generation === event.generation) {
        throw new SequenceError(`prefix ${event.level} begins before the one before it was committed`);
      }
      if ((state.pending.at(-1)?.generation ?? event.generation) !== event.generation) endGeneration(state, dropped);
      state.pending.push({
        generation: event.generation,
        level: event.level,
        regions: event.regions,
        committed: false,
        changes: new Map(),
        missing: new Set(),
        whole: state.fresh,
      });
      break;
    }
    case "chunk": {
      const prefix = openPrefix(state);
      if (prefix?.generation !== event.generation || prefix.level !== event.level) {
        throw new SequenceError(
          `chunk of generation ${event.generation}, level ${event.level} outside its prefix`,
        );
      }
      if (prefix.changes.has(event.region)) throw new SequenceError(`region (${event.region}) twice in one prefix`);
      if (prefix.changes.size >= prefix.regions) {
        throw new SequenceError(`more than the ${prefix.regions} chunks that prefix ${prefix.level} announced`);
      }
      prefix.changes.set(event.region, event.id);
      if (event.id !== null) {
        prefix.missing.add(event.id);
        state.waitedFor.set(event.id, prefix);
      }
      break;
    }
    case "committed": {
      const prefix = openPrefix(state);
      if (prefix?.generation !== event.generation || prefix.level !== event.level) {
        throw new SequenceError(`prefix ${event.level} of generation ${event.generation} committed, but never begun`);
      }
      if (prefix.changes.size !== prefix.regions) {
        throw new SequenceError(
          `prefix ${event.level} committed after ${prefix.changes.size} of ${prefix.regions} chunks`,
        );
      }
      prefix.committed = true;
      state.fresh = false;
      break;
    }
    case "superseded":
      if ((state.pending.at(-1)?.generation ?? Infinity) <= event.generation) endGeneration(state, dropped);
      break;
    case "resident":
      // Unknown when it was dropped while it was uploaded: its owner was told already.
      state.waitedFor.get(event.id)?.missing.delete(event.id);
      state.waitedFor.delete(event.id);
      break;
    case "reset":
      for (const prefix of state.pending) dropChanges(state, prefix, dropped);
      state.pending.length = 0;
      state.fresh = true;
      break;
  }
  return { swaps: takeReady(state), dropped };
}

/** Whether everything that was announced is on screen. */
export function isSettled(state: RegionState): boolean {
  return state.pending.length === 0;
}

function openPrefix(state: RegionState): Prefix | undefined {
  const last = state.pending.at(-1);
  return last?.committed === false ? last : undefined;
}

/** No more frames of this generation: forgets its open prefix and folds the committed ones into one change. */
function endGeneration(state: RegionState, dropped: ChunkId[]): void {
  const open = openPrefix(state);
  if (open !== undefined) {
    dropChanges(state, open, dropped);
    state.pending.pop();
  }
  const [first, ...rest] = state.pending;
  if (first === undefined) return;
  for (const later of rest) {
    for (const [region, id] of later.changes) {
      const earlier = first.changes.get(region);
      if (typeof earlier === "number") {
        first.missing.delete(earlier);
        state.waitedFor.delete(earlier);
        dropped.push(earlier);
      }
      first.changes.set(region, id);
    }
    for (const id of later.missing) {
      first.missing.add(id);
      state.waitedFor.set(id, first);
    }
    first.generation = later.generation;
    first.level = later.level;
  }
  state.pending.length = 1;
}

function takeReady(state: RegionState): Swap[] {
  const swaps: Swap[] = [];
  for (;;) {
    const prefix = state.pending[0];
    if (prefix?.committed !== true || prefix.missing.size > 0) return swaps;
    state.pending.shift();
    const show: ChunkId[] = [];
    const remove: ChunkId[] = [];
    if (prefix.whole) {
      remove.push(...state.shown.values());
      state.shown.clear();
    }
    for (const [region, id] of prefix.changes) {
      const old = state.shown.get(region);
      if (old !== undefined) remove.push(old);
      if (id === null) {
        state.shown.delete(region);
      } else {
        state.shown.set(region, id);
        show.push(id);
      }
    }
    swaps.push({ generation: prefix.generation, level: prefix.level, show, remove });
  }
}

function dropChanges(state: RegionState, prefix: Prefix, dropped: ChunkId[]): void {
  for (const id of prefix.changes.values()) {
    if (id === null) continue;
    state.waitedFor.delete(id);
    dropped.push(id);
  }
}
