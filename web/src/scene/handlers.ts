/** What the scene tells the page. */

import type { Clip } from "./clipping";

export interface RendererHandlers {
  /** A region mesh is on the GPU and can be shown. */
  readonly onResident: (id: number) => void;
  /** A frame was rendered. */
  readonly onFrame: () => void;
  /** The GPU lost its memory; all region meshes are gone and have to be uploaded again. */
  readonly onContextLost: () => void;
  readonly onContextRestored: () => void;
  /** Whether frames are painted with reduced quality while the camera moves, so that they are fast enough; otherwise all are painted in full. */
  readonly adaptsQuality?: boolean;
  /** The user moved a handle of the clip plane or box. */
  readonly onClip?: (clip: Clip) => void;
}
