/** The page: the canvas and its overlays, the panel and the status bar. */

import type { ColorMode } from "../scene/material";
import type { ViewerState } from "../state/viewer";
import { button } from "./controls";
import { ConnectionBanner } from "./connectionBanner";
import { DisplayBar } from "./displayBar";
import { h, setText } from "./dom";
import { formatError } from "./format";
import { Hint } from "./hint";
import { Panel, type PanelHandlers } from "./panel/panel";
import { StatusBar } from "./statusBar";
import { toggleTheme } from "./theme";
import { Toasts } from "./toasts";

export interface PageHandlers extends PanelHandlers {
  readonly onColorMode: (mode: ColorMode) => void;
  readonly onWireframe: (on: boolean) => void;
  readonly onFinestLevel: (level: number) => void;
  readonly onFit: () => void;
  readonly onRetry: () => void;
}

/** Facts about the surface that the page's texts contain. */
export interface SurfaceFacts {
  /** Triangles on screen of each level, finest first. */
  readonly levelTriangles: readonly number[];
  /** The surface on screen is not what the values in force ask for. */
  readonly busy: boolean;
}

export class Page {
  /** Parent of the scene's canvas. */
  readonly viewport = h("div", { class: "viewport" });
  readonly panel: Panel;
  readonly toasts = new Toasts();
  readonly banner: ConnectionBanner;
  private readonly displayBar: DisplayBar;
  private readonly statusBar = new StatusBar();
  private readonly hint = new Hint();
  private readonly notice = button("", "Show all of it, or less", () => this.notice.classList.toggle("open"), "notice");

  constructor(root: HTMLElement, handlers: PageHandlers) {
    this.panel = new Panel(handlers);
    this.banner = new ConnectionBanner(handlers.onRetry);
    this.displayBar = new DisplayBar({ ...handlers, onTheme: toggleTheme });
    const { viewport, displayBar, banner, hint, notice, toasts } = this;
    root.replaceChildren(
      h(
        "main",
        { class: "stage" },
        displayBar.element,
        h("div", { class: "picture" }, viewport, displayBar.legend.element, banner.element, hint.element, notice, toasts.element),
      ),
      this.panel.element,
      this.statusBar.element,
    );
    window.addEventListener("keydown", (event) => {
      if (event.key.toLowerCase() !== "f" || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.target instanceof HTMLInputElement && event.target.type === "text") return;
      if (event.target instanceof HTMLSelectElement) return;
      handlers.onFit();
    });
  }

  /** Copyright or source of the open volume; empty: nothing to show. */
  setNotice(text: string): void {
    setText(this.notice, text);
    this.notice.hidden = text === "";
    this.notice.classList.remove("open");
  }

  /** Brings the texts up to date. */
  update(state: ViewerState, { levelTriangles, busy }: SurfaceFacts): void {
    const triangles = levelTriangles.reduce((sum, n) => sum + n, 0);
    const { shown, progress } = state;
    this.displayBar.legend.setLevelTriangles(levelTriangles);
    this.statusBar.set({
      connection: state.connection,
      working: busy,
      openedShare: state.openedShare,
      generation: shown?.generation,
      prefix: shown?.level,
      triangles,
      // Of the final surface only, which the statistics are of.
      error: busy || shown?.final !== true ? undefined : formatError(state.statistics, 2),
      bytes: progress?.bytes ?? 0,
      totalBytes: state.bytesReceived,
      firstMs: progress?.firstMs,
      lastMs: progress?.lastMs,
      device: state.device,
    });
    this.hint.update(state, triangles, busy);
  }
}
