/** The status hook for tests and scripts. */

import type { ConnectionState } from "../net/connection";
import type { Statistics, View } from "../protocol/types";
import type { SurfaceStyle } from "../state/surfaceList";

/**
 * `window.isopeel.status`: the viewer's state for tests and scripts, so that they can wait for a condition instead of sleeping.
 * Read only; each access returns a new snapshot.
 */
export interface IsopeelStatus {
  readonly connection: ConnectionState;
  /** Id and time step of the open volume. */
  readonly volume: string | undefined;
  readonly step: number;
  /** Of the surface on screen. */
  readonly generation: number | undefined;
  /** Level of the prefix on screen; 0: the final surface. */
  readonly prefix: number | undefined;
  /** Triangles on screen, of all levels and of each (finest first). */
  readonly triangles: number;
  readonly levelTriangles: readonly number[];
  /** Regions on screen. */
  readonly regions: number;
  /** Meshes that the GPU holds, also of what is not on screen. */
  readonly geometries: number;
  /** The server is done, all that it sent is on screen, and no edit waits to be sent. */
  readonly settled: boolean;
  /** Of the selected surface: statistics of its last finished generation, as `extract --stats` prints them, and values in force. */
  readonly statistics: Statistics | undefined;
  readonly edit: View | undefined;
  /** Number of the selected surface, and all of them in their order. */
  readonly selected: number;
  readonly surfaces: readonly SurfaceStatus[];
  /** Triangles on screen by the numbers of surfaces, also of such as were removed and are not gone yet. */
  readonly allTriangles: readonly number[];
  /** Text frames sent since the page was opened, without questions about the surface. */
  readonly framesSent: number;
  /** Frames rendered since the page was opened. */
  readonly framesDrawn: number;
  /** Mesh bytes received since the page was opened. */
  readonly bytesReceived: number;
  /** Chunks received but not decoded yet. */
  readonly undecoded: number;
  /** World units; `fitted` counts how often the camera was fitted. */
  readonly camera: { readonly position: readonly number[]; readonly target: readonly number[]; readonly fitted: number };
  /** Messages that the user has not dismissed. */
  readonly messages: readonly string[];
}

/** The same of each surface. */
interface SurfaceStatus {
  readonly number: number;
  readonly triangles: number;
  readonly statistics: Statistics | undefined;
  readonly edit: View;
  readonly style: SurfaceStyle;
}

declare global {
  interface Window {
    readonly isopeel?: { readonly status: IsopeelStatus };
  }
}

export function installStatus(status: () => IsopeelStatus): void {
  const hook = Object.freeze(Object.defineProperty({}, "status", { get: status, enumerable: true }));
  Object.defineProperty(window, "isopeel", { value: hook, writable: false, configurable: false });
}
