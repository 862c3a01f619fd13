/** Files that the user brings: one upload at a time, with progress, which is opened when it is a volume. */

import type { UploadInfo, UploadList } from "../protocol/types";
import type { NamedFile, UploadPhase } from "../net/uploads";
import type { Store } from "../state/store";
import type { Model, UploadActions } from "../ui/model";
import { removedText } from "../ui/words";

/** The page draws while it sends: a percent is enough. */
const STEPS = 200;

export class FileUploads implements UploadActions {
  private running: AbortController | undefined;

  /** @param onVolumes there are other volumes than before; resolves when the page has their list */
  constructor(
    private readonly store: Store,
    private readonly model: Model,
    private readonly base: URL,
    private readonly onVolumes: () => Promise<void>,
  ) {
    model.uploads = this;
  }

  async start(files: readonly NamedFile[]): Promise<void> {
    const { model } = this;
    if (files.length === 0) return model.toast("There are no files in what was dropped");
    if (this.running !== undefined) return model.toast("An upload is under way: wait for its end, or cancel it");
    const running = new AbortController();
    this.running = running;
    const [title, total] = [titleOf(files), files.reduce((sum, { file }) => sum + file.size, 0)];
    const show = (phase: UploadPhase, sent: number) => {
      const before = model.uploading();
      // While it waits, what was sent before is.
      const now = phase === "waiting" ? (before?.sent ?? 0) : sent;
      if (before?.phase === phase && phase === "sending" && now < total && Math.abs(now - before.sent) * STEPS < total) return;
      model.uploading.set({ title, files: files.length, phase, sent: now, total });
    };
    try {
      const { upload } = await import("../net/uploads");
      const made = await upload(this.base, files, running.signal, show);
      await this.onVolumes();
      const [first] = made.volumes;
      if (first !== undefined) model.actions.openVolume(first);
      model.toast(doneText(made), "brief");
    } catch (error) {
      if (running.signal.aborted) model.toast(`The upload of ${title} was cancelled`, "brief");
      else model.toast(`${title} could not be uploaded: ${error instanceof Error ? error.message : String(error)}`, "lasting");
    } finally {
      this.running = undefined;
      model.uploading.set(undefined);
    }
  }

  cancel(): void {
    this.running?.abort();
  }

  async list(): Promise<UploadList> {
    const { listUploads } = await import("../net/uploads");
    return listUploads(this.base);
  }

  async remove(upload: UploadInfo): Promise<void> {
    try {
      const { removeUpload } = await import("../net/uploads");
      await removeUpload(this.base, upload.id);
      this.model.toast(`${upload.title} was removed`, "brief");
    } catch (error) {
      this.model.toast(`${upload.title} could not be removed: ${error instanceof Error ? error.message : String(error)}`);
    }
    await this.onVolumes();
  }

  /** The open volume is no longer on the server: another one is shown. */
  leaveRemoved(): void {
    const { model, store } = this;
    const removed = store.viewer.target?.volume;
    model.toast(removedText(store.viewer.volume?.title), "lasting");
    void this.onVolumes().then(() => {
      const next = store.viewer.volumes?.find(({ id }) => id !== removed);
      if (next !== undefined && store.viewer.target?.volume === removed) model.actions.openVolume(next.id);
    });
  }
}

function doneText({ title, volumes }: UploadInfo): string {
  return volumes.length > 1 ? `${title} is there, as ${volumes.length} volumes` : `${title} is there`;
}

/** The only file, the folder of all, or the first one: as the server names it. */
function titleOf(files: readonly NamedFile[]): string {
  const name = files[0]?.name ?? "";
  const folder = name.split("/", 1)[0] ?? name;
  return files.length > 1 && files.every((file) => file.name.startsWith(`${folder}/`)) ? folder : name.slice(name.lastIndexOf("/") + 1);
}
