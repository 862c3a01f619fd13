/** Undo and redo over immutable values. A gesture (a drag, a colour being picked) is one step, however many values it takes. */
export class History<T> {
  private past: T[] = [];
  private future: T[] = [];
  /** Value before the gesture under way, and what it changes. */
  private gesture: { readonly before: T; readonly name: string } | undefined;

  /** `depth`: steps kept; a few hundred small lists are a few hundred kilobytes. */
  constructor(
    private value: T,
    private readonly depth = 200,
  ) {}

  get current(): T {
    return this.value;
  }

  get canUndo(): boolean {
    return this.past.length > 0 || (this.gesture !== undefined && this.gesture.before !== this.value);
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** A step of its own. */
  set(value: T): void {
    this.end();
    if (value === this.value) return;
    this.remember(this.value);
    this.value = value;
  }

  /** A value inside a gesture; `end`, or a gesture of another name, makes it one step. */
  drag(value: T, name = ""): void {
    if (this.gesture?.name !== name) this.end();
    this.gesture ??= { before: this.value, name };
    this.value = value;
  }

  /** Another value in place of the current one: no step, and nothing is forgotten. */
  amend(value: T): void {
    this.value = value;
  }

  /** The value before the gesture of this name, if it is under way: it was no step. */
  cancel(name: string): boolean {
    if (this.gesture?.name !== name) return false;
    this.value = this.gesture.before;
    this.gesture = undefined;
    return true;
  }

  /** Ends the gesture, if one is under way. */
  end(): void {
    const before = this.gesture?.before;
    this.gesture = undefined;
    if (before !== undefined && before !== this.value) this.remember(before);
  }

  undo(): boolean {
    this.end();
    const value = this.past.pop();
    if (value === undefined) return false;
    this.future.push(this.value);
    this.value = value;
    return true;
  }

  redo(): boolean {
    this.end();
    const value = this.future.pop();
    if (value === undefined) return false;
    this.past.push(this.value);
    this.value = value;
    return true;
  }

  private remember(value: T): void {
    this.past.push(value);
    if (this.past.length > this.depth) this.past.shift();
    this.future = [];
  }
}
