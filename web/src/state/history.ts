/** Undo and redo over immutable values. A gesture (a drag, a colour being picked) is one step, however many values it takes. Pure. */

export interface History<T> {
  readonly current: T;
  readonly past: readonly T[];
  readonly future: readonly T[];
  /** Value before the gesture under way, and what it changes. */
  readonly gesture: { readonly before: T; readonly name: string } | undefined;
}

/** Steps kept; a few hundred small lists are a few hundred kilobytes. */
const DEPTH = 200;

export function startHistory<T>(current: T): History<T> {
  return { current, past: [], future: [], gesture: undefined };
}

/** Adds a value as a step of its own. */
export function push<T>(history: History<T>, value: T, depth = DEPTH): History<T> {
  const ended = endGesture(history, depth);
  return value === ended.current ? ended : { ...remember(ended, ended.current, depth), current: value };
}

/** Takes a value inside a gesture; `endGesture`, or a gesture of another name, makes it one step. */
export function drag<T>(history: History<T>, value: T, name = ""): History<T> {
  const ended = history.gesture?.name === name ? history : endGesture(history);
  return { ...ended, current: value, gesture: ended.gesture ?? { before: ended.current, name } };
}

/** Replaces the current value: no step, and nothing is forgotten. */
export function amend<T>(history: History<T>, value: T): History<T> {
  return value === history.current ? history : { ...history, current: value };
}

/** Returns to the value before the gesture of this name, if it is under way: it was no step. */
export function cancelGesture<T>(history: History<T>, name: string): History<T> {
  return history.gesture?.name === name ? { ...history, current: history.gesture.before, gesture: undefined } : history;
}

/** Ends the gesture, if one is under way. */
export function endGesture<T>(history: History<T>, depth = DEPTH): History<T> {
  if (history.gesture === undefined) return history;
  const { before } = history.gesture;
  const ended = { ...history, gesture: undefined };
  return before === history.current ? ended : remember(ended, before, depth);
}

export function undo<T>(history: History<T>): History<T> {
  const ended = endGesture(history);
  const { current, past, future } = ended;
  return past.length === 0 ? ended : { ...ended, current: past[past.length - 1] as T, past: past.slice(0, -1), future: [...future, current] };
}

export function redo<T>(history: History<T>): History<T> {
  const ended = endGesture(history);
  const { current, past, future } = ended;
  return future.length === 0 ? ended : { ...ended, current: future[future.length - 1] as T, past: [...past, current], future: future.slice(0, -1) };
}

export function canUndo({ current, past, gesture }: History<unknown>): boolean {
  return past.length > 0 || (gesture !== undefined && gesture.before !== current);
}

function remember<T>(history: History<T>, value: T, depth: number): History<T> {
  return { ...history, past: [...history.past, value].slice(-depth), future: [] };
}
