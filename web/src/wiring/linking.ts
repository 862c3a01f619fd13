/** What a link has of the store, and what is said of one that names no volume of this server. */

import type { LinkState } from "../state/link";
import type { Pose } from "../state/look";
import type { Store } from "../state/store";

/** `undefined` until a volume is open that a link could name. */
export function linkState(store: Store, pose: Pose | undefined): LinkState | undefined {
  const { surfaces, opening, look, openingLook, page: { slicing, story }, viewer, step } = store;
  const { selected, volume, target } = viewer;
  if (opening === undefined || volume === undefined || target?.volume !== volume.id) return undefined;
  return { volume: volume.id, step, surfaces, selected, opening, look, openingLook, slicing, story, pose };
}

/** `shown`: what is open instead, by its id. */
export function unknownVolumeText(store: Store, id: string, shown: string | undefined): string {
  const instead = store.viewer.volumes?.find((volume) => volume.id === shown)?.title;
  return `There is no volume “${id}” on this server${instead === undefined ? "" : `. Shown instead: ${instead}`}`;
}
