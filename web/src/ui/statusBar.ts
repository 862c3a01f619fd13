/** The line at the bottom: what the server is doing and what is on screen. */

import type { ConnectionState } from "../net/connection";
import { h, setText } from "./dom";
import { formatBytes, formatCount, formatMs, formatPercent } from "./format";

export interface StatusBarState {
  readonly connection: ConnectionState;
  readonly working: boolean;
  /** How much of what opening the volume takes is done, while it is being opened. */
  readonly openedShare: number | undefined;
  readonly generation: number | undefined;
  /** Level of the prefix on screen. */
  readonly prefix: number | undefined;
  readonly triangles: number;
  /** Distance of the final surface on screen from the true one, where it is known. */
  readonly error: string | undefined;
  /** Of this generation, and since the page was opened. */
  readonly bytes: number;
  readonly totalBytes: number;
  /** From the edit to its first and to its last frame. */
  readonly firstMs: number | undefined;
  readonly lastMs: number | undefined;
  readonly device: string | undefined;
}

const CONNECTION_TEXT: Readonly<Record<ConnectionState, string>> = {
  connecting: "Connecting",
  connected: "Connected",
  waiting: "Reconnecting",
  stopped: "Disconnected",
};

export class StatusBar {
  readonly element: HTMLElement;
  private readonly cells = new Map<string, HTMLElement>();

  constructor() {
    const cell = (key: string, label: string, hint: string) => {
      const value = h("b");
      this.cells.set(key, value);
      return h("span", { class: `cell ${key}`, title: hint }, label === "" ? undefined : `${label} `, value);
    };
    this.element = h(
      "footer",
      { class: "status-bar" },
      h("span", { class: "dot" }),
      cell("connection", "", "Connection to the server"),
      cell("generation", "Generation", "Counts the edits the server took up"),
      cell("prefix", "Prefix", "Level of the surface on screen: 0 is the final one"),
      cell("triangles", "Triangles", "Triangles on screen"),
      cell("error", "Error", "Distance from the true surface, world units: measured, root mean square and maximum, or ≈ its estimate"),
      cell("bytes", "Received", "Mesh bytes of this generation"),
      cell("first", "First", "From the edit to its first picture"),
      cell("last", "Last", "From the edit to its final picture"),
      h("span", { class: "spring" }),
      cell("device", "", "Device that extracts the surface"),
    );
  }

  set(status: StatusBarState): void {
    const put = (key: string, text: string) => {
      const cell = this.cells.get(key);
      if (cell !== undefined) setText(cell, text);
    };
    this.element.dataset["connection"] = status.connection;
    this.element.classList.toggle("working", status.working);
    put("connection", activity(status));
    put("generation", status.generation === undefined ? "–" : String(status.generation));
    put("prefix", status.prefix === undefined ? "–" : String(status.prefix));
    put("triangles", formatCount(status.triangles));
    put("error", status.error ?? "");
    const error = this.cells.get("error")?.parentElement;
    if (error) error.hidden = status.error === undefined;
    put("bytes", formatBytes(status.bytes));
    put("first", status.firstMs === undefined ? "–" : formatMs(status.firstMs));
    put("last", status.lastMs === undefined ? "–" : formatMs(status.lastMs));
    put("device", status.device ?? "");
    const bytes = this.cells.get("bytes")?.parentElement;
    if (bytes) bytes.title = `Mesh bytes of this generation; ${formatBytes(status.totalBytes)} since the page was opened`;
  }
}

function activity({ connection, working, openedShare }: StatusBarState): string {
  if (connection !== "connected") return CONNECTION_TEXT[connection];
  if (openedShare !== undefined) return `Opening, ${formatPercent(openedShare)}`;
  return working ? "Working" : CONNECTION_TEXT[connection];
}
