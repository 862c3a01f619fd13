/** The status hook for tests and scripts. */

import type { ConnectionState } from "../net/connection";
import type { Statistics, View } from "../protocol/types";

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
  /** The server is done, all that it sent is on screen, and no edit waits to be sent. */
  readonly settled: boolean;
  /** Statistics of the last finished generation, as `extract --stats` prints them. */
  readonly statistics: Statistics | undefined;
  /** Values in force. */
  readonly edit: View | undefined;
  /** Text frames sent since the page was opened. */
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

declare global {
  interface Window {
    readonly isopeel?: { readonly status: IsopeelStatus };
  }
}

export function installStatus(status: () => IsopeelStatus): void {
  const hook = Object.freeze(Object.defineProperty({}, "status", { get: status, enumerable: true }));
  Object.defineProperty(window, "isopeel", { value: hook, writable: false, configurable: false });
}
