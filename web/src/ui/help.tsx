/** Help: what isopeel is, its keys, and links to the documents. */

import { For, onMount, type JSX } from "solid-js";
import { DOCUMENTS } from "./documents";
import { chooseKeys, keysEverywhere } from "./keys";
import { Button } from "./widgets/button";
import { Toggle } from "./widgets/choice";
import { Icon } from "./widgets/icon";

const KEYS: readonly (readonly [string, string])[] = [
  ["Drag, or arrow keys in the picture", "turn the surface"],
  ["Right-drag, or two fingers", "move it"],
  ["Wheel, or pinch", "zoom in or out"],
  ["F", "fit the surface into the picture"],
  ["S", "slices beside the picture, slices alone, the picture alone"],
  ["Click or drag in a slice, or arrow keys", "move the crosshair; so does a click on the surface"],
  ["Wheel in a slice, or Page Up and Page Down", "go through the slices"],
  ["Right-drag in a slice", "change window and level; double-click resets them"],
  [", and .", "previous and next time step; P plays them"],
  ["Ctrl+Z, Ctrl+Shift+Z", "undo, redo: values, colours and look"],
  ["Arrow keys on a slider, a point or a number", "move it; with Shift by more"],
  ["Arrow keys in the list of labels", "go from label to label, and from switch to switch"],
  ["Double-click in the editor, or Insert", "add a point; Delete removes it"],
  ["Pick a value, Mark a region, Measure", "then click the surface, or Enter in the picture for its centre"],
  ["?", "this page"],
];

/** The browser's own dialog: it keeps the focus, and Escape closes it. */
export default function Help(props: { readonly onClose: () => void; readonly onTour: () => void }) {
  let dialog: HTMLDialogElement | undefined;
  onMount(() => dialog?.showModal());
  const close = () => dialog?.close();
  return (
    <dialog ref={(element) => (dialog = element)} class="dialog" aria-labelledby="help-title" on:close={() => props.onClose()}>
      <div class="sheet-head">
        <h2 id="help-title">isopeel</h2>
        <button type="button" class="icon-button" aria-label="Close" on:click={close}>
          <Icon name="close" />
        </button>
      </div>
      <p>
        isopeel shows the surface on which a volume has one value, made with only the triangles that matter: it merges what is flat or
        unimportant before the surface is made, and says how far off that is.
      </p>
      <h3>Keys and gestures</h3>
      <dl class="rows keys">
        <For each={KEYS}>{([keys, about]) => <Row term={keys} about={about} />}</For>
      </dl>
      <Toggle label="Single keys act without a click into the picture" on={keysEverywhere()} onChange={chooseKeys} />
      <h3>Documentation</h3>
      <dl class="rows keys">
        <For each={DOCUMENTS}>{({ name, about }) => <Row term={<Page address={`docs/${name}.txt`} text={name} />} about={about} />}</For>
        <Row term={<Page address="api/v1/openapi.json" text="openapi" />} about="the interface for programs" />
      </dl>
      <Button
        onClick={() => {
          props.onTour();
          close();
        }}
      >
        Take the tour
      </Button>
    </dialog>
  );
}

function Row(props: { readonly term: JSX.Element; readonly about: string }) {
  return (
    <>
      <dt>{props.term}</dt>
      <dd>{props.about}</dd>
    </>
  );
}

function Page(props: { readonly address: string; readonly text: string }) {
  return (
    <a href={props.address} target="_blank">
      {props.text}
    </a>
  );
}
