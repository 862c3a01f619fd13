/** The upload that is under way, over the picture, and the invitation while files are dragged over the page. */

import { createEffect, createSignal, on, onCleanup, Show } from "solid-js";
import { droppedFiles, hasFiles } from "./dropped";
import { formatPercent } from "./format";
import { useModel, type Uploading } from "./model";
import { LACKING } from "../state/roles";
import { Button } from "./widgets/button";
import { uploadText } from "./words";

export function UploadProgress() {
  const model = useModel();
  const { uploading } = model;
  return (
    <Show when={uploading()}>
      {(now) => (
        <div class="upload" role="group" aria-label={`Upload of ${now().title}`}>
          <p class="upload-text">{uploadText(now())}</p>
          <progress max={1} value={shareOf(now())} aria-label="Progress of the upload" />
          <span class="amount">{formatPercent(shareOf(now()))}</span>
          <Button quiet onClick={() => model.uploads?.cancel()}>
            Cancel
          </Button>
          <Said now={now()} />
        </div>
      )}
    </Show>
  );
}

const shareOf = ({ sent, total }: Uploading) => (total === 0 ? 0 : sent / total);

/** Readers of the screen hear when something else happens, not each percent. */
function Said(props: { readonly now: Uploading }) {
  const [text, setText] = createSignal("");
  createEffect(on(() => props.now.phase, () => setText(uploadText(props.now))));
  return (
    <span class="unseen" role="status">
      {text()}
    </span>
  );
}

/** Takes files that are dropped anywhere on the page. */
export function DropTarget() {
  const model = useModel();
  const [isOver, setOver] = createSignal(false);
  const over = (event: DragEvent) => {
    if (!hasFiles(event.dataTransfer)) return;
    // Left alone, the browser would leave the page for the file.
    event.preventDefault();
    if (event.dataTransfer !== null) event.dataTransfer.dropEffect = model.may("upload") ? "copy" : "none";
    setOver(true);
  };
  // Also of elements within the page; the next `dragover` follows at once.
  const leave = (event: DragEvent) => {
    if (event.relatedTarget === null) setOver(false);
  };
  const drop = (event: DragEvent) => {
    const { dataTransfer } = event;
    if (dataTransfer === null || !hasFiles(dataTransfer)) return;
    event.preventDefault();
    setOver(false);
    void droppedFiles(dataTransfer).then((files) => model.uploads?.start(files));
  };
  const listeners = { dragenter: over, dragover: over, dragleave: leave, drop };
  for (const [name, listener] of Object.entries(listeners)) window.addEventListener(name, listener as EventListener);
  onCleanup(() => {
    for (const [name, listener] of Object.entries(listeners)) window.removeEventListener(name, listener as EventListener);
  });
  return (
    <Show when={isOver()}>
      <div class="drop-target">
        <p>{model.may("upload") ? "Drop files or a folder to upload and open them" : LACKING.upload}</p>
      </div>
    </Show>
  );
}
