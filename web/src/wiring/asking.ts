/** Joins questions about the surface to scene, stream and page. */

import type { StreamClient } from "../net/streamClient";
import { Questions } from "../questions/questions";
import type { SurfaceRenderer } from "../scene/renderer";
import { PARTS_GESTURE } from "../state/parts";
import { pointed } from "../state/slicing";
import type { Store } from "../state/store";
import type { Model } from "../ui/model";
import { indexAt } from "../world/places";

/** @param viewport parent of the scene's canvas */
export function makeQuestions(store: Store, model: Model, scene: SurfaceRenderer, client: StreamClient, viewport: HTMLElement): Questions {
  const ask = (question: Parameters<StreamClient["ask"]>[0]) => client.ask(question);
  const questions = new Questions(store, ask, ([x, y]) => scene.pick(x, y, store.viewer.selected), {
    showProbe: (probed) => model.showProbe(probed),
    addPoint: (blended) => model.pick(blended),
    setInterest: (interest) => model.actions.edit({ interest }),
    setParts: (parts) => {
      model.actions.edit({ parts }, PARTS_GESTURE);
      model.actions.endGesture();
      // One that is chosen beside others is one of them now.
      if (store.page.tool === "keep-another") model.actions.changePage({ tool: undefined, kept: [] });
    },
    setMeasures: (measures) => model.actions.changeLook({ measures }),
    setPicked: (picked) => model.actions.changePage({ picked }),
    point: (position) => {
      const { page: { slicing }, viewer: { volume } } = store;
      if (volume !== undefined) model.actions.changePage({ slicing: pointed(slicing, volume.geometry.dims, indexAt(volume.geometry, position)) });
    },
    endTool: () => model.actions.changePage({ tool: undefined }),
    say: (text) => model.toast(text, "brief"),
  });
  questions.listen(viewport);
  return questions;
}
