/** Window and level: which values are black and white, as a drag changes them. Pure. */

export type Window = readonly [black: number, white: number];

/** Pixels of a drag that make the window twice as wide, or move it by half of its width. */
const DOUBLE_AT = 120;

/**
 * To the right the window gets wider, and the contrast lower; upwards the level falls, and the slice gets brighter.
 * @param size of the field's whole range: the window is neither much wider nor a millionth of it
 */
export function draggedWindow([black, white]: Window, right: number, down: number, size: number): Window {
  const before = white - black || size;
  const width = Math.min(4 * size, Math.max(1e-6 * size, before * 2 ** (right / DOUBLE_AT)));
  const level = (black + white) / 2 + (before * down) / (2 * DOUBLE_AT);
  return [level - width / 2, level + width / 2];
}
