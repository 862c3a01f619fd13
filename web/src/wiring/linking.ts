/** State of the store for a link, and the message for a link that names no volume of this server. */

import { decodeLink, type Link, type LinkState } from "../state/link";
import type { Pose } from "../state/look";
import type { Store } from "../state/store";

/** `undefined` until a volume is open that a link could name. */
export function linkState(store: Store, pose: Pose | undefined): LinkState | undefined {
  const { surfaces, opening, look, openingLook, page: { slicing, story }, viewer, step } = store;
  const { selected, volume, target } = viewer;
  if (opening === undefined || volume === undefined || target?.volume !== volume.id) return undefined;
  return { volume: volume.id, step, surfaces, selected, opening, look, openingLook, slicing, story, pose };
}

/** The volume that the server brings along, with a part that matters: what importance is for is seen at once. */
const DEMO = "v=1&volume=mni152&triangles=20000&tf=0,0,3f6f8c;1,0.1,7d2f35&roi=53.7,-26.7,33.5,23,0.95&color=importance&map=ylor&wire=1";

/** The first view of a volume that is opened without a link; `undefined`: as the server opens it, or as it was left. */
export function firstLink(store: Store, volume: string): Link | undefined {
  const demo = decodeLink(DEMO);
  return store.isEmbedded || store.knows(volume) || demo?.volume !== volume ? undefined : demo;
}

/** `shown`: what is open instead, by its id. */
export function unknownVolumeText(store: Store, id: string, shown: string | undefined): string {
  const instead = store.viewer.volumes?.find((volume) => volume.id === shown)?.title;
  return `There is no volume “${id}” on this server${instead === undefined ? "" : `. Shown instead: ${instead}`}`;
}
