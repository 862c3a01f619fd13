/** The top line: what this is, which volume, the surface in words, and what can be done with all of it. */

import { For, Show } from "solid-js";
import { ExportMenu } from "./exportMenu";
import { isLed } from "../state/group";
import { useModel, useScale } from "./model";
import { StatusPopover } from "./statusPopover";
import { toggleTheme } from "./theme";
import { IconButton } from "./widgets/button";
import { Select } from "./widgets/choice";
import { summaryOf } from "./words";

export function TopLine(props: { readonly onHelp: () => void; readonly onUploads: () => void }) {
  const model = useModel();
  const { actions, group, history, page } = model;
  const isSliced = () => page().slicing.layout !== "picture";
  const toggleSlices = () => actions.changePage({ slicing: { ...page().slicing, layout: isSliced() ? "picture" : "both" } });
  return (
    <header class="top">
      <Brand />
      <VolumeChoice />
      <SummaryLine />
      <div class="actions" role="toolbar" aria-label="Page">
        <IconButton icon="undo" label="Undo" keys="Ctrl+Z" disabled={!history().canUndo || isLed(group())} onClick={actions.undo} />
        <IconButton icon="redo" label="Redo" keys="Ctrl+Shift+Z" disabled={!history().canRedo || isLed(group())} onClick={actions.redo} />
        <IconButton icon="fit" label="Fit the surface into the picture" keys="F" onClick={actions.fit} />
        <IconButton class="panel-toggle" icon="slices" label="Slices beside the picture" pressed={isSliced()} disabled={isLed(group())} onClick={toggleSlices} />
        <Show when={model.may("upload")}>
          <IconButton icon="upload" label="Your volumes: upload files" onClick={() => props.onUploads()} />
        </Show>
        <ExportMenu />
        <IconButton icon="theme" label="Switch between dark and light" onClick={toggleTheme} />
        <IconButton icon="help" label="Help" keys="?" onClick={() => props.onHelp()} />
        <IconButton class="panel-toggle" icon="panel" label="Inspector" pressed={page().inspector} onClick={() => actions.changePage({ inspector: !page().inspector })} />
      </div>
    </header>
  );
}

function Brand() {
  return (
    <h1 class="brand">
      <svg class="mark" viewBox="0 0 24 24" aria-hidden="true">
        <path class="mark-a" d="M12 2.5 20.5 7.3v9.4L12 21.5 3.5 16.7V7.3Z" />
        <path class="mark-b" d="M12 12 20.5 7.3M12 12v9.500M12 12 3.5 7.3" />
      </svg>
      isopeel
    </h1>
  );
}

function VolumeChoice() {
  const { actions, group, viewer } = useModel();
  const options = () => (viewer().volumes ?? []).map(({ id, title }) => ({ value: id, text: title }));
  return (
    <fieldset class="volume-choice" disabled={isLed(group())}>
      <Select label="Volume" hideLabel value={viewer().target?.volume} options={options()} onChange={actions.openVolume} />
    </fieldset>
  );
}

function SummaryLine() {
  const { facts, viewer } = useModel();
  const scale = useScale();
  const triangles = () => facts().levelTriangles.reduce((sum, n) => sum + n, 0);
  const summary = () => summaryOf(viewer(), triangles(), facts().busy, scale());
  return (
    <div class="summary" classList={{ working: facts().busy }} data-connection={viewer().connection}>
      <StatusPopover />
      <p class="sentence">
        <For each={summary().parts}>{(part) => <span>{part}</span>}</For>
        <Show when={summary().activity}>{(text) => <span class="activity">{text()}</span>}</Show>
      </p>
    </div>
  );
}
