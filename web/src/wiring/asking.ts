/** Questions about the surface, joined to scene and page. */

import type { StreamClient } from "../net/streamClient";
import { Questions } from "../questions/questions";
import type { SurfaceRenderer } from "../scene/renderer";
import type { Store } from "../state/store";
import type { UserEvent } from "../state/work";
import type { Model } from "../ui/model";
import { slicingAt } from "./slicePlanes";

interface AskingParts {
  readonly store: Store;
  readonly model: Model;
  readonly scene: SurfaceRenderer;
  readonly client: StreamClient;
  readonly act: (event: UserEvent) => void;
  readonly isStill: () => boolean;
}

/** @param viewport parent of the scene's canvas */
export function makeQuestions({ store, model, scene, client, act, isStill }: AskingParts, viewport: HTMLElement): Questions {
  const questions = new Questions(store, (question) => client.ask(question), ([x, y]) => scene.pick(x, y, store.viewer.selected), {
    showProbe: model.probe.set,
    addPoint: (x) => model.picked.set({ x }),
    act,
    point: (position) => act({ type: "page", layers: { slicing: slicingAt(store, position) } }),
    isStill,
    say: (text) => model.toast(text, "brief"),
  });
  questions.listen(viewport);
  return questions;
}
