/** Batch jobs: the view that is shown is made for other isovalues, while the page does other things or is closed. */

import { createSignal, For, onCleanup, Show } from "solid-js";
import { createStore, reconcile } from "solid-js/store";
import type { JobInfo } from "../../protocol/types";
import { isFinished, isovaluesOf, justFinished } from "../../state/jobs";
import { FORMATS } from "../exportMenu";
import { formatValue } from "../format";
import type { MeshFormat } from "../actions";
import { useModel, type JobActions } from "../model";
import { Button } from "../widgets/button";
import { Choice } from "../widgets/choice";
import { TextRow } from "../widgets/textRow";
import { finishedText, jobText, titleOf } from "./jobWords";
import "../style/jobs.css";

/** How often the server is asked while something is made, and while nothing is. */
const BUSY_MS = 1500;
const IDLE_MS = 10_000;
/** Those that are listed here; the command line lists all. */
const MAX_LISTED = 20;

const OPTIONS = FORMATS.map(({ format, text }) => ({ value: format, text: format.toUpperCase(), hint: text }));

/** Kept while the page is open: the card may be folded in between. */
const [typed, setTyped] = createSignal<string>();
const [format, setFormat] = createSignal<MeshFormat>("glb");

export default function Body() {
  const { jobs } = useModel();
  return <Show when={jobs}>{(actions) => <Jobs actions={actions()} />}</Show>;
}

function Jobs(props: { readonly actions: JobActions }) {
  const { list, refresh } = useList(() => props.actions);
  const act = (does: Promise<void>) => void does.then(refresh);
  return (
    <>
      <Submit onSubmit={(isovalues) => props.actions.submit(isovalues, format()).then(refresh)} />
      <Show when={list.error}>{(error) => <p class="note">The list could not be read: {error()}</p>}</Show>
      <ul class="jobs" aria-label="Your batch jobs">
        <For each={list.jobs.slice(0, MAX_LISTED)}>
          {(job) => <Row job={job} onCancel={() => act(props.actions.cancel(job))} onDelete={() => act(props.actions.remove(job))} onDownload={() => act(props.actions.download(job))} />}
        </For>
      </ul>
      <Show when={list.jobs.length > MAX_LISTED}>
        <p class="note">{list.jobs.length - MAX_LISTED} older ones: isopeel jobs list</p>
      </Show>
    </>
  );
}

function Submit(props: { readonly onSubmit: (isovalues: readonly number[]) => Promise<void> }) {
  const { say, view } = useModel();
  const [isSending, setSending] = createSignal(false);
  const text = () => typed() ?? formatValue(view()?.iso ?? 0);
  const isWrong = () => typeof isovaluesOf(text()) === "string";
  const submit = (event: SubmitEvent) => {
    event.preventDefault();
    const isovalues = isovaluesOf(text());
    if (typeof isovalues === "string") return say(isovalues);
    if (isSending()) return;
    setSending(true);
    void props.onSubmit(isovalues).finally(() => setSending(false));
  };
  return (
    <form on:submit={submit}>
      <TextRow label="Isovalues" value={text()} isInvalid={isWrong()} onInput={setTyped} />
      <div class="control row">
        <span class="label">Format</span>
        <Choice<MeshFormat> label="Format of the files" value={format()} options={OPTIONS} onChange={setFormat} />
      </div>
      <div class="control row">
        <p class="note">One file per isovalue with the current settings. Runs when the server is idle</p>
        <button type="submit" class="button" disabled={isSending()}>
          Submit
        </button>
      </div>
    </form>
  );
}

function Row(props: { readonly job: JobInfo; readonly onCancel: () => void; readonly onDelete: () => void; readonly onDownload: () => void }) {
  const { viewer } = useModel();
  const title = () => titleOf(viewer().volumes, props.job.volume);
  const of = () => `${title()}, ${new Date(1000 * props.job.submitted).toLocaleString()}`;
  const { extractions } = props.job;
  return (
    <li>
      <strong>{of()}</strong>
      <span class="about">{jobText(props.job)}</span>
      <Show when={!isFinished(props.job)}>
        <progress max={extractions.total} value={extractions.done + extractions.failed + extractions.empty} aria-label={`Progress of ${of()}`} />
      </Show>
      <span class="inline">
        <Show when={isFinished(props.job) && extractions.done > 0}>
          <Button label={`Download ${of()}`} onClick={() => props.onDownload()}>
            Download
          </Button>
        </Show>
        <Show
          when={isFinished(props.job)}
          fallback={
            <Button label={`Cancel ${of()}`} onClick={() => props.onCancel()}>
              Cancel
            </Button>
          }
        >
          <Button quiet label={`Delete ${of()}`} onClick={() => props.onDelete()}>
            Delete
          </Button>
        </Show>
      </span>
    </li>
  );
}

/** The list, asked for again and again while the card is unfolded and the page is seen. */
function useList(actions: () => JobActions) {
  const { say, viewer } = useModel();
  // When jobs change, their rows are kept, and so buttons keep the focus.
  const [list, setList] = createStore<{ jobs: readonly JobInfo[]; error: string | undefined }>({ jobs: [], error: undefined });
  let timer: ReturnType<typeof setTimeout> | undefined;
  let known: readonly JobInfo[] = [];
  let isOver = false;
  const look = async () => {
    if (!document.hidden) await read();
    clearTimeout(timer);
    if (!isOver) timer = setTimeout(() => void look(), known.every(isFinished) ? IDLE_MS : BUSY_MS);
  };
  const read = async () => {
    try {
      const jobs = await actions().list();
      for (const job of justFinished(known, jobs)) say(finishedText(job, viewer().volumes));
      known = jobs;
      setList("jobs", reconcile([...structuredClone(jobs)], { key: "id" }));
      setList("error", undefined);
    } catch (error) {
      setList("error", error instanceof Error ? error.message : String(error));
    }
  };
  onCleanup(() => {
    isOver = true;
    clearTimeout(timer);
  });
  void look();
  return { list, refresh: () => void look() };
}
