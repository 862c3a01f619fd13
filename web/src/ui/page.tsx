/** The page: the picture and what lies over it, the top line, and the inspector. */

import { createSignal, lazy, Show, Suspense } from "solid-js";
import { render } from "solid-js/web";
import { ConnectionBanner } from "./connectionBanner";
import { EmbeddedPage } from "./embeddedPage";
import { FollowBar } from "./followBar";
import { Hint } from "./hint";
import { Inspector } from "./inspector";
import { listenToKeys } from "./keys";
import { Legend } from "./legend";
import { Announcer } from "./announcer";
import { ModelContext, useModel, type Model } from "./model";
import { Notice } from "./notice";
import { ProbeReadout } from "./probeReadout";
import { Toasts } from "./toasts";
import { TopLine } from "./topLine";
import { isTourDue } from "./tourState";
import { DropTarget, UploadProgress } from "./uploadProgress";
import { isLed } from "../state/group";

const Help = lazy(() => import("./help"));
const SlicePanel = lazy(() => import("./slicePanel/panel"));
const Telling = lazy(() => import("./telling"));
const Tour = lazy(() => import("./tour"));
const Uploads = lazy(() => import("./uploads"));

/**
 * Shows the page in `root`.
 * @param viewport parent of the scene's canvas
 * @param isEmbedded the picture alone
 */
export function showPage(root: HTMLElement, model: Model, viewport: HTMLElement, isEmbedded: boolean): void {
  root.replaceChildren();
  render(
    () => (
      <ModelContext.Provider value={model}>
        {isEmbedded ? <EmbeddedPage viewport={viewport} /> : <Page viewport={viewport} />}
      </ModelContext.Provider>
    ),
    root,
  );
}

function Page(props: { readonly viewport: HTMLElement }) {
  const model = useModel();
  const [help, setHelp] = createSignal(false);
  const [uploads, setUploads] = createSignal(false);
  const [tour, setTour] = createSignal(isTourDue());
  const hasSurface = () => model.viewer().shown !== undefined;
  listenToKeys(model, props.viewport, () => setHelp(true));
  return (
    <div class="page" classList={{ "no-inspector": !model.page().inspector }}>
      <TopLine onHelp={() => setHelp(true)} onUploads={() => setUploads(true)} />
      <Stage viewport={props.viewport} />
      <Inspector />
      <Announcer />
      <DropTarget />
      <Suspense>
        <Show when={uploads()}>
          <Uploads onClose={() => setUploads(false)} />
        </Show>
        <Show when={help()}>
          <Help onClose={() => setHelp(false)} onTour={() => setTour(true)} />
        </Show>
        <Show when={tour() && hasSurface() && !help() && !isLed(model.group())}>
          <Tour onEnd={() => setTour(false)} />
        </Show>
      </Suspense>
    </div>
  );
}

/** The picture, and slices beside it or in its place. */
function Stage(props: { readonly viewport: HTMLElement }) {
  const { page, telling } = useModel();
  const layout = () => page().slicing.layout;
  return (
    <div class="stage">
      <div class="split" data-layout={layout()}>
        <main class="picture" classList={{ aiming: page().tool !== undefined }} data-tour="picture" aria-label="Surface">
          {props.viewport}
          <Legend editable />
          <Hint />
          <ProbeReadout />
          <FollowBar />
          <ConnectionBanner />
          <UploadProgress />
          <Notice />
          <Suspense>
            <Show when={telling()}>
              <Telling />
            </Show>
          </Suspense>
          <Toasts />
        </main>
        <Suspense>
          <Show when={layout() !== "picture"}>
            <SlicePanel />
          </Show>
        </Suspense>
      </div>
    </div>
  );
}
