/** Messages to the user, in a corner of the canvas, until they are dismissed. */

import { button } from "./controls";
import { h } from "./dom";

/** Shown at once; a further one replaces the oldest. */
const MAX_TOASTS = 4;

export class Toasts {
  readonly element = h("div", { class: "toasts", role: "alert", "aria-live": "assertive" });
  private readonly shown = new Map<string, HTMLElement>();

  /** Texts that are shown, oldest first. */
  get texts(): string[] {
    return [...this.shown.keys()];
  }

  show(text: string): void {
    if (this.shown.has(text)) return;
    const toast = h("div", { class: "toast" }, h("p", {}, text));
    toast.append(button("Dismiss", "Close this message", () => this.dismiss(text), "button quiet"));
    this.shown.set(text, toast);
    this.element.append(toast);
    if (this.shown.size > MAX_TOASTS) this.dismiss([...this.shown.keys()][0] ?? text);
  }

  dismiss(text: string): void {
    this.shown.get(text)?.remove();
    this.shown.delete(text);
  }

  clear(): void {
    for (const text of this.texts) this.dismiss(text);
  }
}
