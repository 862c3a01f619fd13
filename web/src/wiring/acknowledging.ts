/** Acknowledgement of an edit's first frame. */

import { isLoopback } from "../net/loopback";
import type { StreamClient } from "../net/streamClient";
import type { SurfaceRenderer } from "../scene/renderer";
import type { Store } from "../state/store";
import { firstCoarseFrames, isUnderWay, type ViewerState } from "../state/viewer";

interface Parts {
  readonly store: Store;
  readonly scene: SurfaceRenderer;
  readonly client: StreamClient;
  readonly base: URL;
}

/** A frame was rendered. @param before what was known before it */
export function acknowledgeFrames(before: ViewerState, parts: Parts): void {
  for (const generation of firstCoarseFrames(before, parts.store.viewer)) void acknowledge(generation, parts);
}

/**
 * Tells a server on this machine that an edit's first frame is rendered. Without a GPU both work on the same processors: the
 * server leaves them to the viewer until then. Not sent when the server is done already, for nothing waits for it then.
 */
async function acknowledge(generation: number, { store, scene, client, base }: Parts): Promise<void> {
  if (scene.onGpu || !isLoopback(base.hostname)) return;
  await scene.finished();
  if (isUnderWay(store.viewer, generation)) client.acknowledge(generation);
}
