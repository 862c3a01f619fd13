/** Keys of the page: undo and redo, and single keys. */

import { createSignal, onCleanup } from "solid-js";
import { isLed } from "../state/group";
import { nextLayout } from "../state/slicing";
import { stepCount } from "../state/timeSteps";
import type { Model } from "./model";

/** Types of inputs that hold a text. */
const TEXTS: readonly string[] = ["text", "search"];
const KEY = "isopeel.keys";

function stored(): boolean {
  try {
    return localStorage.getItem(KEY) !== "picture";
  } catch {
    // Storage may be forbidden; the choice then lasts as long as the page.
    return true;
  }
}

const [isEverywhere, setEverywhere] = createSignal(stored());

/** Whether single keys act if no element has the focus; else only if the picture or a slice has it, so that speech that is taken for keys does nothing. */
export const keysEverywhere = isEverywhere;

export function chooseKeys(everywhere: boolean): void {
  setEverywhere(everywhere);
  try {
    if (everywhere) localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, "picture");
  } catch {
    // Storage may be forbidden.
  }
}

/** Whether single keys act while an element has the focus. The page itself has it if no other element does. */
function takesKeys(target: Element, viewport: HTMLElement): boolean {
  return viewport.contains(target) || target.matches(".slice-picture") || (isEverywhere() && target === document.body);
}

/** Undo and redo anywhere but in texts, which have their own. */
export function listenToKeys(model: Model, viewport: HTMLElement, onHelp: () => void): void {
  const { actions } = model;
  const onKey = (event: KeyboardEvent) => {
    const { target } = event;
    if (event.altKey || (target instanceof HTMLInputElement && TEXTS.includes(target.type))) return;
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey) {
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      return key === "y" || event.shiftKey ? actions.redo() : actions.undo();
    }
    if (target instanceof Element && takesKeys(target, viewport)) act(key, model, viewport, onHelp);
  };
  window.addEventListener("keydown", onKey);
  onCleanup(() => window.removeEventListener("keydown", onKey));
}

function act(key: string, { actions, group, step, page, viewer }: Model, viewport: HTMLElement, onHelp: () => void): void {
  const count = stepCount(viewer());
  const to = { ",": step() - 1, ".": step() + 1 }[key];
  if (to !== undefined && to >= 0 && to < count) actions.goToStep(to);
  const { player } = page();
  if (key === "p" && count > 1) actions.changePage({ player: { ...player, playing: !player.playing } });
  if (key === "f") actions.fit();
  if (key === "s" && !isLed(group())) {
    const layout = nextLayout(page().slicing);
    actions.changePage({ slicing: { ...page().slicing, layout } });
    // The slice that had the focus is gone.
    if (layout === "picture") viewport.querySelector("canvas")?.focus();
  }
  if (key === "?") onHelp();
}
