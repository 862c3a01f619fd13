/** Building blocks of the panel. */

import { h } from "../dom";

/** A block of the panel; without a title it has no heading. */
export function section(title: string, ...children: HTMLElement[]): HTMLElement {
  return h("section", { class: "section" }, title === "" ? undefined : h("h2", {}, title), ...children);
}

/** A control with its label before it. */
export function row(title: string, hint: string, element: HTMLElement): HTMLElement {
  return h("div", { class: "control row" }, h("span", { class: "label", title: hint }, title), element);
}
