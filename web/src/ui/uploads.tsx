/** The dialog of uploads: files are chosen, and what was uploaded before is opened or removed. */

import { createResource, For, onMount, Show } from "solid-js";
import type { UploadInfo } from "../protocol/types";
import { chosenFiles } from "./dropped";
import { formatBytes } from "./format";
import { useModel } from "./model";
import { Button } from "./widgets/button";
import { Icon } from "./widgets/icon";

/** The browser's own dialog: it keeps the focus, and Escape closes it. */
export default function Uploads(props: { readonly onClose: () => void }) {
  const model = useModel();
  const { actions, uploads } = model;
  let dialog: HTMLDialogElement | undefined;
  onMount(() => dialog?.showModal());
  const close = () => dialog?.close();
  const [list, { refetch }] = createResource(() => (model.takesUploads() ? uploads?.list() : Promise.reject(new Error("Uploads are disabled on this server (--uploads DIR)"))));
  const remove = async (upload: UploadInfo) => {
    await uploads?.remove(upload);
    await refetch();
  };
  const open = (id: string) => {
    close();
    actions.openVolume(id);
  };
  const choose = (files: FileList | null) => {
    close();
    void uploads?.start(chosenFiles(files));
  };
  return (
    <dialog ref={(element) => (dialog = element)} class="dialog" aria-labelledby="uploads-title" on:close={() => props.onClose()}>
      <div class="sheet-head">
        <h2 id="uploads-title">Your volumes</h2>
        <button type="button" class="icon-button" aria-label="Close" on:click={close}>
          <Icon name="close" />
        </button>
      </div>
      <Show when={list.error === undefined} fallback={<p role="status">{messageOf(list.error)}</p>}>
        <p>Drop files or a folder anywhere on the page, or choose them: a NIfTI or NRRD file, a header with its samples, numbered slices, a folder of DICOM files. Only you and the server's administrators see them.</p>
        <div class="upload-buttons">
          <Chooser text="Choose files" isFolder={false} onChoose={choose} />
          <Chooser text="Choose a folder" isFolder onChoose={choose} />
        </div>
        <Show when={list()}>
          {(found) => (
            <>
              <h3>
                Uploaded, {formatBytes(found().usedBytes)} of {formatBytes(found().quotaBytes)}
              </h3>
              <ul class="upload-list">
                <For each={found().uploads} fallback={<li class="upload-about">Nothing yet.</li>}>
                  {(upload) => <Row upload={upload} isOfSeveral={found().uploads.some(({ owner }) => owner !== upload.owner)} onOpen={open} onRemove={() => void remove(upload)} />}
                </For>
              </ul>
            </>
          )}
        </Show>
      </Show>
    </dialog>
  );
}

const messageOf = (error: unknown) => (error instanceof Error ? error.message : String(error));

/** @param props.isOfSeveral an administrator's list has the uploads of several users */
function Row(props: { readonly upload: UploadInfo; readonly isOfSeveral: boolean; readonly onOpen: (id: string) => void; readonly onRemove: () => void }) {
  const about = () => {
    const { bytes, receivedBytes, state, error, expires } = props.upload;
    if (error !== null) return `cannot be read: ${error}`;
    if (state === "receiving") return `${formatBytes(receivedBytes)} of ${formatBytes(bytes)} are there; drop the same files again to go on`;
    return `${formatBytes(bytes)}, kept until ${new Date(expires).toLocaleDateString()} and longer when used`;
  };
  const first = () => props.upload.volumes[0];
  return (
    <li>
      <div class="upload-what">
        <strong>{props.upload.title}</strong>
        <span class="upload-about">{props.isOfSeveral ? `${props.upload.owner}: ${about()}` : about()}</span>
      </div>
      <Show when={first()}>
        {(id) => (
          <Button quiet label={`Open ${props.upload.title}`} onClick={() => props.onOpen(id())}>
            Open
          </Button>
        )}
      </Show>
      <Button quiet label={`Remove ${props.upload.title}`} onClick={() => props.onRemove()}>
        Remove
      </Button>
    </li>
  );
}

/** A button that opens the browser's own chooser. */
function Chooser(props: { readonly text: string; readonly isFolder: boolean; readonly onChoose: (files: FileList | null) => void }) {
  let input: HTMLInputElement | undefined;
  return (
    <>
      <Button onClick={() => input?.click()}>{props.text}</Button>
      <input
        ref={(element) => {
          input = element;
          element.webkitdirectory = props.isFolder;
        }}
        type="file"
        multiple
        hidden
        aria-label={props.text}
        on:change={(event) => {
          if ((event.currentTarget.files?.length ?? 0) > 0) props.onChoose(event.currentTarget.files);
        }}
      />
    </>
  );
}
