/** The bar above the surface: how it is displayed. All of it happens in the browser. */

import { LEVELS } from "../protocol/generated";
import type { ColorMode } from "../scene/material";
import { Segmented, Toggle, button } from "./controls";
import { h } from "./dom";
import { Legend } from "./legend";

export interface DisplayBarHandlers {
  readonly onColorMode: (mode: ColorMode) => void;
  readonly onWireframe: (on: boolean) => void;
  readonly onFinestLevel: (level: number) => void;
  readonly onFit: () => void;
  readonly onTheme: () => void;
}

export class DisplayBar {
  readonly element: HTMLElement;
  readonly legend = new Legend();

  constructor(handlers: DisplayBarHandlers) {
    const color = new Segmented<ColorMode>(
      "Colour by",
      [
        { value: "transfer", text: "Transfer function", hint: "Colour by transfer function" },
        { value: "level", text: "Level", hint: "Colour by level of decimation" },
        { value: "importance", text: "Importance", hint: "Colour by importance" },
      ],
      (mode) => {
        this.legend.show(mode);
        handlers.onColorMode(mode);
      },
    );
    color.set("transfer");
    const peel = new Segmented(
      "Show levels from",
      Array.from({ length: LEVELS }, (_, level) => ({
        value: level,
        text: String(level),
        hint: level === 0 ? "Show all levels" : `Peel: show only levels ${level} and coarser`,
      })),
      handlers.onFinestLevel,
    );
    peel.set(0);
    const wire = new Toggle("Wireframe", "Draw the edges of the triangles", handlers.onWireframe);
    const theme = button("◐", "Dark or light", handlers.onTheme, "button icon");
    theme.setAttribute("aria-label", "Switch between dark and light");
    this.element = h(
      "div",
      { class: "display-bar", role: "toolbar", "aria-label": "View" },
      color.element,
      h("div", { class: "labelled" }, h("span", { class: "label", title: "Show only levels from this one up" }, "Levels ≥"), peel.element),
      wire.element,
      h("span", { class: "display-actions" }, button("Fit", "Fit the surface into the view (F)", handlers.onFit), theme),
    );
  }
}
