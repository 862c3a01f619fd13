/** What `window.isopeel.status` says. */

import type { StreamClient } from "../net/streamClient";
import type { RegionPipeline } from "../regions/pipeline";
import type { SurfaceRenderer } from "../scene/renderer";
import type { Store } from "../state/store";
import type { Model } from "../ui/model";
import type { IsopeelStatus } from "../ui/statusHook";
import type { Framing } from "./framing";

const sum = (numbers: readonly number[]) => numbers.reduce((total, n) => total + n, 0);

interface StatusParts {
  readonly store: Store;
  readonly model: Model;
  readonly scene: SurfaceRenderer;
  readonly framing: Framing;
  readonly pipeline: RegionPipeline;
  readonly client: StreamClient;
}

/** @param settled the server is done, and all of it is on screen */
export function statusOf({ store, model, scene, framing, pipeline, client }: StatusParts, settled: boolean): IsopeelStatus {
  const { surfaces, viewer } = store;
  const { levelTriangles, levelTrianglesBySurface } = scene;
  const states = viewer.known;
  return {
    connection: viewer.connection,
    volume: viewer.volume?.id,
    step: viewer.target?.step ?? 0,
    generation: viewer.shown?.generation,
    prefix: viewer.shown?.level,
    triangles: sum(levelTriangles),
    levelTriangles,
    regions: scene.regionCount,
    geometries: scene.geometries,
    settled,
    statistics: viewer.statistics,
    edit: viewer.view,
    selected: viewer.selected,
    surfaces: surfaces.map(({ number, view, style }) => ({
      number,
      triangles: sum(levelTrianglesBySurface[number] ?? []),
      statistics: states.get(number)?.statistics,
      edit: view,
      style,
    })),
    allTriangles: levelTrianglesBySurface.map(sum),
    framesSent: client.framesSent,
    framesDrawn: scene.framesRendered,
    bytesReceived: viewer.bytesReceived,
    undecoded: pipeline.undecoded,
    camera: { ...scene.camera.pose, fitted: framing.fitted },
    messages: model.toasts().filter(({ good }) => !good).map(({ text }) => text),
  };
}
