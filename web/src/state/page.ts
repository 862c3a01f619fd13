/** Layers of the page: what of it is open, the tool in hand, slices and bookmarks. */

import type { Vec3 } from "../protocol/types";
import type { MeasureKind } from "./measure";
import type { PartTool } from "./parts";
import { FIRST_SLICING, type Slicing } from "./slicing";
import type { Story } from "./story";

/** What a click on the surface does besides turning it: a point for the editor at its value, a region of interest there, a part
 * of the surface that goes or stays alone, or a measurement. */
export type Tool = "pick" | "paint" | PartTool | MeasureKind;

export interface PageLayers {
  readonly inspector: boolean;
  /** The card in the sheet of a narrow page. */
  readonly sheet: string | undefined;
  /** Cards that are folded, and cards that were unfolded by hand, by their ids. */
  readonly folded: Readonly<Record<string, boolean>>;
  readonly tool: Tool | undefined;
  /** Points of what is being measured. */
  readonly picked: readonly Vec3[];
  /** Parts that are kept, while all are shown so that another one can be chosen. */
  readonly kept: readonly Vec3[];
  /** Which regions of interest are outlined in the picture: all, or all and one of them, by its number, more than the others. */
  readonly outlined: "all" | number | undefined;
  /** Radius of the regions that are marked, world units; `undefined`: a share of the volume. */
  readonly brush: number | undefined;
  readonly player: Player;
  /** Slices beside the picture. */
  readonly slicing: Slicing;
  /** Bookmarks, of all volumes. */
  readonly story: Story;
}

/** How time steps are played. */
interface Player {
  readonly playing: boolean;
  /** Steps in a second at most. */
  readonly speed: number;
  /** The first step follows the last one. */
  readonly loop: boolean;
}

export const FIRST_PAGE: PageLayers = {
  inspector: true,
  sheet: undefined,
  folded: {},
  tool: undefined,
  picked: [],
  kept: [],
  outlined: undefined,
  brush: undefined,
  // Until the user chooses: slow enough to see each step.
  player: { playing: false, speed: 5, loop: true },
  slicing: FIRST_SLICING,
  story: [],
};
