/** Files and texts that leave the page: the mesh of what is seen, its link, its command line. */

import { extract } from "../net/rest";
import type { View, ViewCamera } from "../protocol/types";
import { commandLine } from "../state/commandLine";
import { surfaceFileName } from "../state/fileNames";
import { labelsName } from "../state/labels";
import { aloneView } from "../state/sharedBudget";
import type { Store } from "../state/store";
import type { ViewerState } from "../state/viewer";
import type { MeshFormat } from "./actions";
import type { Model } from "./model";
import { surfaceName } from "./surfaceNames";

/** Hands a file to the browser to be saved. */
export function saveFile(name: string, file: Blob): void {
  const url = URL.createObjectURL(file);
  const anchor = document.createElement("a");
  anchor.href = url;
  anchor.download = name;
  anchor.click();
  // The browser has begun to read it by then.
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

/** Puts a text on the clipboard, and says so; shows it if the browser does not allow that. */
export async function copyOut(model: Model, text: string, done: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
    model.toast(done, "brief");
  } catch {
    model.toast(`The browser does not let the page copy. Copy it from here: ${text}`);
  }
}

/** The selected surface's values, as a mesh of it alone has them. */
export function exportedView(viewer: ViewerState, cap: boolean): View | undefined {
  const view = aloneView(viewer);
  return view && { ...view, cap };
}

/** Of the selected surface. `camera`: that of the picture, for which it is made. */
export async function copyCommand(model: Model, store: Store, camera: ViewCamera | undefined, cap = false): Promise<void> {
  const { statistics, target, selected } = store.viewer;
  const view = exportedView(store.viewer, cap);
  if (view === undefined || target === undefined) return;
  const name = surfaceName(store.surfaces, selected);
  const done = `Command${name && ` for ${name}`} copied. Put the volume's file in place of its name`;
  await copyOut(model, commandLine(target.volume, target.step, view, statistics, camera), done);
}

/** Has the server make the mesh of the selected surface, and saves it. */
export async function downloadMesh(model: Model, store: Store, base: URL, format: MeshFormat, cap = false): Promise<void> {
  const view = exportedView(store.viewer, cap);
  const { target } = store.viewer;
  if (view === undefined || target === undefined) return;
  const { volume, step } = target;
  const name = surfaceFileName(store.viewer.volume, view.iso, labelsName(store.viewer.volume, view.field));
  await saveMade(model, `${name}.${format}`, () => extract(base, volume, step, format, view));
}

/** Saves what takes a while to be made, and says so. */
export async function saveMade(model: Model, name: string, make: () => Promise<Blob>): Promise<void> {
  const waiting = `Making ${name}`;
  model.toast(waiting, "lasting");
  try {
    saveFile(name, await make());
    model.toast(`${name} is ready`, "brief");
  } catch (error) {
    model.toast(`${name} could not be made: ${error instanceof Error ? error.message : String(error)}`);
  } finally {
    model.dismiss(waiting);
  }
}
