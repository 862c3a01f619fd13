/** Adaptive binary range decoder of the coding `predictive` (PROTOCOL.md, section 4.1). Pure. */

/** Lowest probability of either bit, in units of 1/2¹². */
const MIN_PROBABILITY = 16;
const MAX_PROBABILITY = (1 << 12) - MIN_PROBABILITY;
/** A range with none of these bits takes a further byte. */
const HIGH_BITS = 0xff << 24;
/** XORed with both operands, it makes a signed comparison of 32-bit words an unsigned one. */
const SIGN = 1 << 31;
/** Bits after which a model learns no slower. */
const MAX_SEEN = 100;
/** How fast a model learns, by the number of bits that it has seen, in units of 1/2¹⁶. */
const RATES = Uint16Array.from({ length: MAX_SEEN + 1 }, (_, seen) => Math.floor((2 << 16) / (2 * seen + 5)));

/** Bits of the largest magnitude of a number. */
const MAX_LENGTH = 20;
/** Models of a number in one context: for each number of bits, whether its magnitude has more; and its sign. */
const CONTEXT_MODELS = MAX_LENGTH + 1;
const BELOW_HIGHEST_MODELS = 3;

/** Models of numbers that are coded alike: their first model for each kind of bit, in consecutive contexts. */
export interface NumberModel {
  readonly first: number;
  readonly belowHighest: number;
}

export class RangeDecoder {
  /** 32-bit words without a sign, kept as numbers with one: the engine has no others of 32 bits. */
  private code = 0;
  private range = -1;
  private at = 0;
  /** Of each model: the probability of a 1 in units of 1/2¹⁶, and the bits that were coded, up to the maximum. */
  private readonly probabilities: Uint16Array;
  private readonly seen: Uint8Array;
  private models = 0;

  /** @param maxModels how many models there are at most */
  constructor(
    private readonly payload: Uint8Array,
    maxModels: number,
  ) {
    this.probabilities = new Uint16Array(maxModels).fill(1 << 15);
    this.seen = new Uint8Array(maxModels);
    for (let i = 0; i < 4; i += 1) this.takeByte();
  }

  /** Models of bits; returns the first one's number. */
  addBits(count: number): number {
    const first = this.models;
    this.models += count;
    if (this.models > this.seen.length) throw new Error(`${this.models} models of ${this.seen.length}`);
    return first;
  }

  addNumber(contexts: number): NumberModel {
    return { first: this.addBits(contexts * CONTEXT_MODELS), belowHighest: this.addBits((MAX_LENGTH + 1) * BELOW_HIGHEST_MODELS) };
  }

  /** Whether more was read than there is. */
  get isExhausted(): boolean {
    return this.at > this.payload.length;
  }

  /** Whether all was read, and no more. */
  get isAtEnd(): boolean {
    return this.at === this.payload.length;
  }

  /** A bit of a model. */
  bit(model: number): boolean {
    const probability = this.probabilities[model] ?? 0;
    const bound = Math.imul(this.range >>> 12, Math.min(Math.max(probability >>> 4, MIN_PROBABILITY), MAX_PROBABILITY));
    const bit = (this.code ^ SIGN) < (bound ^ SIGN);
    const seen = this.seen[model] ?? 0;
    const rate = RATES[seen] ?? 0;
    if (seen < MAX_SEEN) this.seen[model] = seen + 1;
    if (bit) {
      this.range = bound;
      this.probabilities[model] = probability + (((0xffff - probability) * rate) >>> 16);
    } else {
      this.range = (this.range - bound) | 0;
      this.code = (this.code - bound) | 0;
      this.probabilities[model] = probability - ((probability * rate) >>> 16);
    }
    while ((this.range & HIGH_BITS) === 0) this.nextByte();
    return bit;
  }

  /** Decodes `bits` bits without a model. */
  raw(bits: number): number {
    let value = 0;
    for (let i = 0; i < bits; i += 1) {
      this.range >>>= 1;
      value <<= 1;
      if ((this.code ^ SIGN) >= (this.range ^ SIGN)) {
        this.code = (this.code - this.range) | 0;
        value += 1;
      }
      while ((this.range & HIGH_BITS) === 0) this.nextByte();
    }
    return value;
  }

  number(model: NumberModel, context: number): number {
    const first = model.first + context * CONTEXT_MODELS;
    let length = 0;
    while (length < MAX_LENGTH && this.bit(first + length)) length += 1;
    if (length === 0) return 0;
    const isNegative = this.bit(first + MAX_LENGTH);
    let magnitude = 1;
    let below = length - 1;
    for (let node = 0; below > 0 && node < BELOW_HIGHEST_MODELS; below -= 1) {
      const bit = this.bit(model.belowHighest + length * BELOW_HIGHEST_MODELS + node) ? 1 : 0;
      magnitude = 2 * magnitude + bit;
      node = 2 * node + 1 + bit;
    }
    magnitude = (magnitude << below) + this.raw(below);
    return isNegative ? -magnitude : magnitude;
  }

  private nextByte(): void {
    this.range <<= 8;
    this.takeByte();
  }

  private takeByte(): void {
    this.code = (this.code << 8) | (this.payload[this.at] ?? 0);
    this.at += 1;
  }
}
