/** How far the vertices on screen are from the isosurface, all of them taken together. Pure. */

/** World units. */
export interface Distances {
  /** This share of the vertices is nearer than `upper`. */
  readonly share: number;
  /** Rounded up to two digits: the end of the colours. */
  readonly upper: number;
  /** The farthest; infinite if no isosurface is near. */
  readonly farthest: number;
}

/** Nearer than this many voxels is no distance at all: colours of a surface without error would be noise. */
const SMALLEST = 0.001;
/** The few that are farthest would make all others look alike. */
const SHARE = 0.98;
/** A number that is not near the isosurface at all is above this. */
const NOT_NEAR = 1e29;
/** Positive 32-bit floats are ordered as their bits are. The upper half of the bits gives a number to within a hundredth. */
const HALF = 16;

/** @param spacing the volume's smallest one */
export function distancesOf(values: readonly Float32Array[], spacing: number): Distances {
  const counts = new Uint32Array(1 << HALF);
  let [total, farthest] = [0, 0];
  for (const of of values) {
    const bits = new Uint32Array(of.buffer, of.byteOffset, of.length);
    total += of.length;
    for (let i = 0; i < of.length; i += 1) {
      const upper = (bits[i] ?? 0) >>> HALF;
      counts[upper] = (counts[upper] ?? 0) + 1;
      farthest = Math.max(farthest, of[i] ?? 0);
    }
  }
  const upper = Math.max(SMALLEST * spacing, Math.min(farthest, bound(counts, SHARE * total)));
  return { share: SHARE, upper: roundedUp(Math.min(upper, NOT_NEAR)), farthest: farthest < NOT_NEAR ? farthest : Infinity };
}

/** Of several surfaces: nearer than `upper` is at least this share of the vertices of each. `undefined` of none. */
export function together(all: readonly Distances[]): Distances | undefined {
  if (all.length === 0) return undefined;
  return { share: SHARE, upper: Math.max(...all.map(({ upper }) => upper)), farthest: Math.max(...all.map(({ farthest }) => farthest)) };
}

/** The upper end of the bin below which there are as many. */
function bound(counts: Uint32Array, wanted: number): number {
  let [bin, sum] = [0, 0];
  while (bin < counts.length && sum < wanted) {
    sum += counts[bin] ?? 0;
    bin += 1;
  }
  return new Float32Array(new Uint32Array([bin << HALF]).buffer)[0] ?? 0;
}

function roundedUp(value: number): number {
  const unit = 10 ** (Math.floor(Math.log10(value)) - 1);
  return Number((Math.ceil(value / unit - 1e-9) * unit).toPrecision(2));
}
