/** The boundary of the part of a mesh that is decoded: directed edges, linked to loops (PROTOCOL.md, section 4.1). Pure. */

/** Kinds of place that the third vertex of a triangle has. */
export const THIRD = { new: 0, right: 1, left: 2, other: 3 } as const;
export type Third = (typeof THIRD)[keyof typeof THIRD];

const NONE = -1;

export class Boundary {
  readonly from: Int32Array;
  readonly to: Int32Array;
  /** The third vertex of the triangle in front of the edge, and that triangle's level. */
  readonly opposite: Int32Array;
  readonly level: Uint8Array;
  readonly previous: Int32Array;
  readonly next: Int32Array;
  readonly isOpen: Uint8Array;
  /** Whether no triangle is behind it. */
  readonly isBorder: Uint8Array;
  /** An edge that ended at each vertex. */
  private readonly ending: Int32Array;
  private edges = 0;

  constructor(triangles: number, vertices: number) {
    const edges = 3 * triangles;
    const numbers = () => new Int32Array(edges);
    [this.from, this.to, this.opposite, this.previous, this.next] = [numbers(), numbers(), numbers(), numbers(), numbers()];
    [this.level, this.isOpen, this.isBorder] = [new Uint8Array(edges), new Uint8Array(edges), new Uint8Array(edges)];
    this.ending = new Int32Array(vertices).fill(NONE);
  }

  /** The loop around a first triangle: three edges from the returned one on. */
  start(a: number, b: number, c: number, level: number): number {
    const first = this.edges;
    this.add(a, c, b, level, first + 2, first + 1);
    this.add(c, b, a, level, first, first + 2);
    this.add(b, a, c, level, first + 1, first);
    this.ending[c] = first;
    this.ending[b] = first + 1;
    this.ending[a] = first + 2;
    return first;
  }

  /** Covers the triangle behind an edge. Returns the edge at the start of that one; the edge at its end has the next number. */
  cover(edge: number, c: number, third: Third, level: number): number {
    const a = at(this.from, edge);
    const b = at(this.to, edge);
    const previous = at(this.previous, edge);
    const next = at(this.next, edge);
    const isLeftToo = at(this.from, previous) === c;
    const met = at(this.ending, c);
    const isMet = met !== NONE && met !== edge && this.isOpen[met] === 1 && at(this.to, met) === c;
    const left = this.edges;
    const right = left + 1;
    this.add(a, c, b, level, previous, right);
    this.add(c, b, a, level, left, next);
    this.isOpen[edge] = 0;
    this.next[previous] = left;
    this.previous[next] = right;
    this.ending[b] = right;
    this.ending[c] = left;
    if (third === THIRD.other && isMet) this.split(met, left, right);
    if (third === THIRD.right) this.close(right, next, c, left);
    if (third === THIRD.left || (third === THIRD.right && isLeftToo)) {
      const before = at(this.previous, left);
      this.close(before, left, c, at(this.previous, before));
    }
    return left;
  }

  /** Of each vertex, whether an edge of it is open. */
  borderVertices(): Uint8Array {
    const atBorder = new Uint8Array(this.ending.length);
    for (let edge = 0; edge < this.edges; edge += 1) {
      if (this.isOpen[edge] !== 1) continue;
      atBorder[at(this.from, edge)] = 1;
      atBorder[at(this.to, edge)] = 1;
    }
    return atBorder;
  }

  private add(from: number, to: number, opposite: number, level: number, previous: number, next: number): void {
    const edge = this.edges;
    this.edges += 1;
    this.from[edge] = from;
    this.to[edge] = to;
    this.opposite[edge] = opposite;
    this.level[edge] = level;
    this.previous[edge] = previous;
    this.next[edge] = next;
    this.isOpen[edge] = 1;
  }

  /** The loop meets itself, or another one, at the end of `met`. */
  private split(met: number, left: number, right: number): void {
    const after = at(this.next, met);
    this.next[left] = after;
    this.previous[after] = left;
    this.next[met] = right;
    this.previous[right] = met;
  }

  /** Removes two consecutive edges that run there and back. `ending` ends at `c` from now on. */
  private close(first: number, second: number, c: number, ending: number): void {
    const before = at(this.previous, first);
    const after = at(this.next, second);
    this.isOpen[first] = 0;
    this.isOpen[second] = 0;
    this.next[before] = after;
    this.previous[after] = before;
    this.ending[c] = ending;
  }
}

const at = (values: Int32Array, index: number): number => values[index] ?? 0;
