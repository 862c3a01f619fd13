/** Page for a browser that cannot draw: an explanation, and the meshes to download. */

import { createResource, createSignal, For, Show } from "solid-js";
import { render } from "solid-js/web";
import { extract, listVolumes } from "../net/rest";
import type { Edit, VolumeSummary } from "../protocol/types";
import { FORMATS } from "./exportMenu";
import { saveFile } from "./takeAlong";
import { Button } from "./widgets/button";

/** What is downloaded: the cut that a volume opens with. */
const DOWNLOADED: Edit = { feature: "gradient-magnitude", alpha: 0.5, error: "1px", triangles: { share: 0.25, max: 1_000_000 } };

export function showNoWebGl(root: HTMLElement, base: URL, reason: string): void {
  root.replaceChildren();
  render(() => <NoWebGl base={base} reason={reason} />, root);
}

function NoWebGl(props: { readonly base: URL; readonly reason: string }) {
  const [volumes, { refetch }] = createResource(() => listVolumes(props.base));
  const [note, setNote] = createSignal("");
  const download = async (volume: string, format: string) => {
    setNote("The mesh is being made");
    try {
      saveFile(`${volume}.${format}`, await extract(props.base, volume, 0, format, DOWNLOADED));
      setNote("");
    } catch (error) {
      setNote(error instanceof Error ? error.message : String(error));
    }
  };
  return (
    <main class="fatal">
      <h1>isopeel cannot draw here</h1>
      <p role="alert">The picture needs WebGL 2, and this browser does not offer it: {props.reason}</p>
      <p>Turn on hardware acceleration in the browser's settings, or try another browser. The surfaces can be downloaded without it:</p>
      <Show when={volumes.error === undefined} fallback={<Unlisted error={volumes.error as unknown} onRetry={() => void refetch()} />}>
        <For each={volumes() ?? []}>{(volume) => <Downloads volume={volume} onChoose={(format) => void download(volume.id, format)} />}</For>
      </Show>
      <p role="status">{note()}</p>
    </main>
  );
}

function Unlisted(props: { readonly error: unknown; readonly onRetry: () => void }) {
  return (
    <p class="downloads">
      <span>The list of volumes could not be read: {props.error instanceof Error ? props.error.message : String(props.error)}</span>
      <Button onClick={props.onRetry}>Try again</Button>
    </p>
  );
}

function Downloads(props: { readonly volume: VolumeSummary; readonly onChoose: (format: string) => void }) {
  return (
    <p class="downloads">
      <span>{props.volume.title}</span>
      <For each={FORMATS}>
        {({ format }) => <Button onClick={() => props.onChoose(format)}>{format.toUpperCase()}</Button>}
      </For>
    </p>
  );
}
