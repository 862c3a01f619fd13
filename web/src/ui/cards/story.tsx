/** Bookmarks of what is shown, in the order of a story. */

import { For, Show } from "solid-js";
import { volumeName } from "../../state/fileNames";
import { isInLink, MAX_SENTENCE, moved, withText } from "../../state/story";
import { storyFile } from "../../state/storyFile";
import { useModel } from "../model";
import { saveFile } from "../takeAlong";
import { Button } from "../widgets/button";
import { Icon } from "../widgets/icon";
import "../style/story.css";

/** Images of a video have the size of the picture, and what is in them. */
const VIDEO = { scale: 1, transparent: false, colorBar: true, scaleBar: true, isovalues: true, slices: false, caption: "" };

const FORMATS = [
  { format: "webm", text: "WebM", about: "A video, recorded while the story is played" },
  { format: "mp4", text: "MP4", about: "A video, made frame by frame" },
  { format: "images", text: "PNGs", about: "Numbered images of all frames in a ZIP, with a list for ffmpeg" },
] as const;

export default function Body() {
  const model = useModel();
  const { actions, page, telling } = model;
  const story = () => page().story;
  return (
    <>
      <div class="control row">
        <p class="note">{story().length === 0 ? "A bookmark keeps volume, surfaces, colours and camera, with a sentence. Several are a story that can be played" : ""}</p>
        <Button onClick={() => actions.story({ type: "add" })}>Add bookmark</Button>
      </div>
      <ol class="bookmarks" aria-label="Bookmarks">
        <For each={story()}>{(_, index) => <Row index={index()} />}</For>
      </ol>
      <Show when={story().length > 0}>
        <div class="control row">
          <Show when={telling() === undefined} fallback={<Button onClick={() => actions.story({ type: "stop" })}>Stop</Button>}>
            <Button onClick={() => actions.story({ type: "play" })}>Play</Button>
            <span class="inline" role="group" aria-label="Save the story">
              <For each={FORMATS}>
                {({ format, text, about }) => (
                  <button type="button" class="chip" title={about} aria-label={`Save the story as ${text}`} on:click={() => actions.story({ type: "record", format, request: VIDEO })}>
                    {text}
                  </button>
                )}
              </For>
            </span>
          </Show>
        </div>
      </Show>
      <Files />
    </>
  );
}

function Row(props: { readonly index: number }) {
  const model = useModel();
  const { actions, page, telling } = model;
  const story = () => page().story;
  const number = () => props.index + 1;
  const change = (to: readonly { readonly text: string; readonly state: string }[]) => actions.changePage({ story: to });
  const remove = () => {
    const before = story();
    change(before.toSpliced(props.index, 1));
    model.ask(`Bookmark ${number()} is deleted`, [{ text: "Undo", act: () => change(before) }]);
  };
  return (
    <li classList={{ told: telling()?.index === props.index }}>
      <button type="button" class="chip" aria-label={`Show bookmark ${number()}`} title="Show" on:click={() => actions.story({ type: "show", index: props.index })}>
        {number()}
      </button>
      <input
        class="text"
        type="text"
        aria-label={`Sentence of bookmark ${number()}`}
        placeholder="A sentence about it"
        maxlength={MAX_SENTENCE}
        value={story()[props.index]?.text ?? ""}
        on:change={(event) => change(withText(story(), props.index, event.currentTarget.value))}
      />
      <button type="button" class="icon-button up" aria-label={`Move bookmark ${number()} up`} title="Move up" disabled={props.index === 0} on:click={() => change(moved(story(), props.index, props.index - 1))}>
        <Icon name="chevron" />
      </button>
      <button type="button" class="icon-button" aria-label={`Move bookmark ${number()} down`} title="Move down" disabled={props.index === story().length - 1} on:click={() => change(moved(story(), props.index, props.index + 1))}>
        <Icon name="chevron" />
      </button>
      <button type="button" class="icon-button" aria-label={`Delete bookmark ${number()}`} title="Delete" on:click={remove}>
        <Icon name="close" />
      </button>
    </li>
  );
}

function Files() {
  const model = useModel();
  const { page, volume } = model;
  let input: HTMLInputElement | undefined;
  const open = (from: HTMLInputElement) => {
    const [file] = from.files ?? [];
    if (file !== undefined) model.actions.story({ type: "open", file });
    // The same file may be opened again.
    from.value = "";
  };
  const save = () => saveFile(`${volumeName(volume())}-story.json`, new Blob([storyFile(page().story)], { type: "application/json" }));
  return (
    <>
      <div class="control row">
        <span class="label">File</span>
        <span class="inline">
          <Button disabled={page().story.length === 0} onClick={save}>
            Save story
          </Button>
          <Button onClick={() => input?.click()}>Open story…</Button>
        </span>
        <input ref={(element) => (input = element)} class="unseen" type="file" accept=".json,application/json" tabindex="-1" aria-label="File of a story" on:change={(event) => open(event.currentTarget)} />
      </div>
      <Show when={!isInLink(page().story)}>
        <p class="note">Too long for the link: save it as a file</p>
      </Show>
    </>
  );
}
