/** Batch jobs of the page: submits the view that is shown for chosen isovalues, and saves results. */

import { isEqual } from "../protocol/equal";
import type { JobRequest } from "../net/jobs";
import type { JobInfo } from "../protocol/types";
import { volumeName } from "../state/fileNames";
import type { Store } from "../state/store";
import { submittedText, titleOf } from "../ui/cards/jobWords";
import type { MeshFormat } from "../ui/actions";
import type { JobActions, Model } from "../ui/model";
import { exportedView, saveFile } from "../ui/takeAlong";

export class BatchJobs implements JobActions {
  /** A request that had no answer, and its key: sent again it makes no second job. */
  private unanswered: { readonly request: JobRequest; readonly key: string } | undefined;
  /** The last one that was submitted, until it is cancelled or deleted, has failed, or is no longer listed. */
  private last: { readonly request: JobRequest; readonly id: string } | undefined;

  constructor(
    private readonly store: Store,
    private readonly model: Model,
    private readonly base: URL,
  ) {}

  async list(): Promise<readonly JobInfo[]> {
    const { listJobs } = await import("../net/jobs");
    const { last } = this;
    const jobs = await listJobs(this.base);
    const state = jobs.find(({ id }) => id === last?.id)?.state;
    // One that is submitted meanwhile may not be listed yet.
    if (this.last === last && (state === undefined || state === "failed" || state === "cancelled")) this.last = undefined;
    return jobs;
  }

  async submit(isovalues: readonly number[], format: MeshFormat): Promise<void> {
    const { viewer } = this.store;
    const view = exportedView(viewer, false);
    if (view === undefined || viewer.target === undefined) return;
    const { volume, step } = viewer.target;
    const request = { volume, extractions: isovalues.map((iso) => ({ ...view, iso, step, format })) };
    // Enter is easily pressed twice.
    if (isEqual(this.last?.request, request)) return this.model.toast("This job is submitted already: change isovalues, format or settings for another one", "brief");
    await this.try("The job was not submitted", async () => this.model.toast(submittedText(await this.send(request)), "brief"));
  }

  cancel(job: JobInfo): Promise<void> {
    return this.try("The job was not cancelled", async () => (await import("../net/jobs")).cancelJob(this.base, job.id));
  }

  remove(job: JobInfo): Promise<void> {
    if (job.id === this.last?.id) this.last = undefined;
    return this.try("The job was not deleted", async () => (await import("../net/jobs")).removeJob(this.base, job.id));
  }

  download(job: JobInfo): Promise<void> {
    return this.try("The results could not be fetched", async () => {
      const { fetchResults } = await import("../net/jobs");
      const { name, file } = await fetchResults(this.base, job, volumeName({ id: job.volume, title: titleOf(this.store.viewer.volumes, job.volume) }));
      saveFile(name, file);
      this.model.toast(`${name} is ready`, "brief");
    });
  }

  private async send(request: JobRequest): Promise<JobInfo> {
    const { submitJob } = await import("../net/jobs");
    const { key } = this.unanswered !== undefined && isEqual(this.unanswered.request, request) ? this.unanswered : { key: randomKey() };
    this.unanswered = { request, key };
    const job = await submitJob(this.base, request, key);
    this.unanswered = undefined;
    this.last = { request, id: job.id };
    return job;
  }

  private async try(failed: string, act: () => Promise<void>): Promise<void> {
    try {
      await act();
    } catch (error) {
      this.model.toast(`${failed}: ${error instanceof Error ? error.message : String(error)}`);
    }
  }
}

/** `randomUUID` is for encrypted pages alone. */
const randomKey = () => [...crypto.getRandomValues(new Uint32Array(4))].map((n) => n.toString(16).padStart(8, "0")).join("");
