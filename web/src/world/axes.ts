/** The world's axes, and what they are in a patient. Pure. */

/** An end of one of the world's axes: `+x` that of the first. */
export type AxisName = "+x" | "-x" | "+y" | "-y" | "+z" | "-z";

/** A side of a patient. */
export interface Side {
  readonly letter: string;
  readonly word: string;
}

const LEFT: Side = { letter: "L", word: "left" };
const RIGHT: Side = { letter: "R", word: "right" };
const FRONT: Side = { letter: "A", word: "front (anterior)" };
const BACK: Side = { letter: "P", word: "back (posterior)" };
const HEAD: Side = { letter: "S", word: "head (superior)" };
const FEET: Side = { letter: "I", word: "feet (inferior)" };

/** The sides of a patient along the world's axes; none in a frame that is not a patient's. */
export function sidesOf(frame: string | undefined): Partial<Readonly<Record<AxisName, Side>>> {
  if (frame === "LPS") return { "+x": LEFT, "-x": RIGHT, "+y": BACK, "-y": FRONT, "+z": HEAD, "-z": FEET };
  if (frame === "RAS") return { "+x": RIGHT, "-x": LEFT, "+y": FRONT, "-y": BACK, "+z": HEAD, "-z": FEET };
  return {};
}
