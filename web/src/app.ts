/** The viewer: what the user does goes to session and scene, what the server says to scene and controls. */

import { installHook, type IsopeelStatus } from "./ui/statusHook";
import type { ConnectionState } from "./net/connection";
import { isLoopback } from "./net/loopback";
import { listVolumes } from "./net/rest";
import { StreamClient } from "./net/streamClient";
import { Throttle } from "./net/throttle";
import { complete, type View, type Edit, type ServerMessage, type Statistics, type VolumeInfo, type VolumeSummary } from "./protocol/types";
import { SurfaceRenderer } from "./scene/renderer";
import { RegionPipeline } from "./regions/pipeline";
import { IMPORTANCE_STOPS, LEVEL_COLORS, rampLut, transferLut } from "./transfer/lut";
import { IDENTITY, sameImportance, sorted, toWire, type Points } from "./transfer/model";
import { button } from "./ui/controls";
import { h, setText } from "./ui/dom";
import { formatValue } from "./ui/format";
import { Panel } from "./ui/panel";
import { StatusBar } from "./ui/statusBar";
import { followTheme, toggleTheme } from "./ui/theme";
import { Toasts } from "./ui/toasts";
import { DisplayBar } from "./ui/displayBar";

/** One generation, from the edit that caused it to its last picture. */
interface Run {
  readonly generation: number;
  /** When the edit went out, by `performance.now()`. */
  readonly startedAt: number;
  bytes: number;
  firstMs: number | undefined;
  lastMs: number | undefined;
}

/** A connection may take this long before the user is told that there is none. */
const PATIENCE_MS = 1200;
/** Texts follow an edit under way this often. */
const PROGRESS_MS = 250;
/** A dragged time slider opens this often at most: each step is read from disk. */
const STEP_INTERVAL_MS = 200;

export class App {
  private readonly panel: Panel;
  private readonly displayBar: DisplayBar;
  private readonly statusBar = new StatusBar();
  private readonly toasts = new Toasts();
  private readonly scene: SurfaceRenderer;
  private readonly pipeline: RegionPipeline;
  private readonly client: StreamClient;
  private readonly hint = h("div", { class: "hint", role: "status" });
  private readonly banner = h("div", { class: "banner", role: "status", hidden: true });
  private readonly bannerText = h("span");
  private readonly notice = button("", "Show all of it, or less", () => this.notice.classList.toggle("open"), "notice");

  private connection: ConnectionState = "connecting";
  private patience: ReturnType<typeof setTimeout> | undefined;
  private volumes: readonly VolumeSummary[] | undefined;
  private target: { readonly volume: string; readonly step: number } | undefined;
  private wantedStep = 0;
  private readonly stepThrottle = new Throttle(STEP_INTERVAL_MS, () => {
    const { target, wantedStep } = this;
    if (target !== undefined && target.step !== wantedStep) this.open(target.volume, wantedStep);
  });
  private opening = false;
  private volume: VolumeInfo | undefined;
  private edit: View | undefined;
  private device: string | undefined;
  private statistics: Statistics | undefined;
  private editSentAt = 0;
  /** An edit was sent and its generation is not done. */
  private working = false;
  private run: Run | undefined;
  private shown: { readonly generation: number; readonly level: number } | undefined;
  private undrawn = false;
  private totalBytes = 0;
  private needsFit = true;
  private refreshing: ReturnType<typeof setTimeout> | undefined;
  private fitted = 0;

  /** @throws when the browser cannot draw */
  constructor(
    root: HTMLElement,
    private readonly base: URL,
  ) {
    this.panel = new Panel({
      onVolume: (id) => {
        this.stepThrottle.cancel();
        this.open(id, 0);
      },
      onStep: (step) => {
        this.wantedStep = step;
        this.stepThrottle.call();
      },
      onEdit: (change) => this.change(change),
      onPoints: (points) => this.changePoints(points),
    });
    this.displayBar = new DisplayBar({
      onColorBy: (mode) => this.scene.setColorMode(mode),
      onWireframe: (on) => this.scene.setWireframe(on),
      onFinestLevel: (level) => this.scene.setFinestLevel(level),
      onFit: () => this.fit(false),
      onTheme: toggleTheme,
    });
    this.banner.append(this.bannerText, button("Retry now", "Connect at once", () => this.client.retryNow(), "button quiet"));
    const viewport = h("div", { class: "viewport" });
    root.replaceChildren(
      h(
        "main",
        { class: "stage" },
        this.displayBar.element,
        h("div", { class: "picture" }, viewport, this.displayBar.legend, this.banner, this.hint, this.notice, this.toasts.element),
      ),
      this.panel.element,
      this.statusBar.element,
    );

    this.scene = new SurfaceRenderer(
      viewport,
      { transfer: transferLut(IDENTITY), importance: rampLut(IMPORTANCE_STOPS), levels: LEVEL_COLORS },
      {
        onResident: (id) => this.pipeline.resident(id),
        onDrawn: () => this.drawn(),
        onContextLost: () => {
          this.pipeline.clear();
          this.toasts.show("The graphics device was reset; the picture comes back when it does");
        },
        onContextRestored: () => {
          this.toasts.clear();
          this.client.restart();
        },
      },
    );
    const worker = new Worker(new URL("./decode/worker.ts", import.meta.url), { type: "module", name: "decode" });
    this.pipeline = new RegionPipeline(
      worker,
      this.scene,
      ({ generation, level }) => {
        this.shown = { generation, level };
        this.undrawn = true;
        if (this.needsFit && this.scene.regionCount > 0) {
          this.needsFit = false;
          this.fit(true);
        }
      },
      (reason) => {
        this.broken(reason);
        this.client.restart();
      },
    );
    const stream = new URL("api/v1/stream", base);
    stream.protocol = base.protocol === "https:" ? "wss:" : "ws:";
    this.client = new StreamClient(stream.href, {
      onState: (state, detail) => this.connectionChanged(state, detail),
      onReset: () => void this.pipeline.event({ type: "reset" }),
      onMessage: (message) => this.receive(message),
      onChunk: (frame) => {
        this.totalBytes += frame.byteLength;
        if (this.run !== undefined) this.run.bytes += frame.byteLength;
        this.pipeline.chunk(frame);
        this.refreshSoon();
      },
      onBroken: (reason) => this.broken(reason),
      onEditSent: () => {
        this.editSentAt = performance.now();
        this.working = true;
        this.refreshSoon();
      },
    });

    followTheme((theme) => this.scene.setEdgeColor(theme === "dark" ? "#0b0e12" : "#101418"));
    window.addEventListener("keydown", (event) => {
      if (event.key.toLowerCase() !== "f" || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.target instanceof HTMLInputElement && event.target.type === "text") return;
      if (event.target instanceof HTMLSelectElement) return;
      this.fit(false);
    });
    installHook(() => this.status());
    this.refresh();
  }

  start(): void {
    this.client.start();
  }

  private open(volume: string, step: number): void {
    this.target = { volume, step };
    this.opening = true;
    if (this.volumes !== undefined) this.panel.setVolumes(this.volumes, volume);
    const page = new URL(window.location.href);
    page.hash = new URLSearchParams({ volume }).toString();
    window.history.replaceState(null, "", page);
    this.client.open(volume, step);
    this.refresh();
  }

  private change(change: Edit): void {
    if (this.edit === undefined) return;
    const whole = complete(change);
    this.edit = { ...this.edit, ...whole };
    this.panel.setEdit(this.edit);
    this.applyAlpha();
    this.client.edit(whole);
    this.refreshSoon();
  }

  private changePoints(points: Points): void {
    this.scene.setTransfer(transferLut(points));
    if (this.edit === undefined) return;
    const transferFunction = toWire(points);
    const recoloured = sameImportance(this.edit.transferFunction.points, transferFunction.points);
    this.edit = { ...this.edit, transferFunction };
    // Colours are looked up in the shader: nothing leaves the browser.
    if (recoloured) this.client.remember({ transferFunction });
    else this.client.edit({ transferFunction });
    this.refreshSoon();
  }

  /** Without a feature there is nothing to weigh: its values are zero, and colours follow smoothness alone. */
  private applyAlpha(): void {
    if (this.edit !== undefined) this.scene.setAlpha(this.edit.alpha);
  }

  private receive(message: ServerMessage): void {
    switch (message.type) {
      case "opened":
        this.opened(message);
        break;
      case "prefix": {
        const { generation, level, regions } = message;
        if (this.run?.generation !== generation) {
          this.run = { generation, startedAt: this.editSentAt, bytes: 0, firstMs: undefined, lastMs: undefined };
        }
        this.working = true;
        this.pipeline.event({ type: "prefix", generation, level, regions });
        return this.refreshSoon();
      }
      case "committed":
        this.pipeline.event({ type: "committed", generation: message.generation, level: message.level });
        return this.refreshSoon();
      case "superseded":
        this.pipeline.event({ type: "superseded", generation: message.generation });
        return this.refreshSoon();
      case "done":
        this.working = false;
        this.statistics = message.statistics;
        this.panel.setStatistics(message.statistics);
        this.toasts.clear();
        break;
      case "error":
        this.working = false;
        this.opening = false;
        this.toasts.show(message.message);
        break;
    }
    this.refresh();
  }

  private opened({ volume, step, edit, device }: Extract<ServerMessage, { type: "opened" }>): void {
    const another = this.volume?.id !== volume.id;
    this.opening = false;
    this.volume = volume;
    this.device = device;
    this.run = undefined;
    if (another) {
      this.pipeline.clear();
      this.shown = undefined;
      this.statistics = undefined;
      this.panel.setStatistics(undefined);
      this.needsFit = true;
    }
    this.scene.setGrid(volume.geometry);
    const points = sorted(edit.transferFunction.points);
    this.edit = { ...edit, transferFunction: { points } };
    this.panel.setVolume(volume, step);
    this.panel.setEdit(this.edit);
    // A restored session brings the user's own points back: the history goes on.
    if (another) this.panel.editor.replace(points);
    this.scene.setTransfer(transferLut(this.panel.editor.points));
    this.applyAlpha();
    setText(this.notice, volume.notice ?? "");
    this.notice.hidden = volume.notice === null;
    this.notice.classList.remove("open");
    document.title = `${volume.title} · isopeel`;
  }

  private broken(reason: string): void {
    this.toasts.show(`${reason}. Starting over`);
  }

  private connectionChanged(state: ConnectionState, detail: string | undefined): void {
    this.connection = state;
    if (state === "connected") {
      clearTimeout(this.patience);
      this.patience = undefined;
      this.banner.hidden = true;
      void this.loadVolumes();
    } else {
      this.working = false;
      if (state === "waiting" && detail !== undefined) setText(this.bannerText, `Connection closed: ${detail}. Reconnecting`);
      else if (this.banner.hidden) setText(this.bannerText, "No connection to the server. Reconnecting");
      this.patience ??= setTimeout(() => (this.banner.hidden = false), PATIENCE_MS);
    }
    this.refresh();
  }

  private async loadVolumes(): Promise<void> {
    try {
      this.volumes = await listVolumes(this.base);
    } catch (error) {
      this.toasts.show(`The list of volumes could not be read: ${error instanceof Error ? error.message : String(error)}`);
      return;
    }
    this.panel.setVolumes(this.volumes, this.target?.volume);
    if (this.target === undefined) {
      const named = new URLSearchParams(window.location.hash.slice(1)).get("volume");
      const first = this.volumes.find((v) => v.id === named) ?? this.volumes[0];
      if (first !== undefined) this.open(first.id, 0);
    }
    this.refresh();
  }

  private fit(fresh: boolean): void {
    this.scene.fit(fresh);
    this.fitted += 1;
  }

  private drawn(): void {
    const { run, shown } = this;
    if (this.undrawn && run !== undefined && run.generation === shown?.generation) {
      if (run.firstMs === undefined && shown.level > 0) void this.tellDrawn(run.generation);
      const elapsed = performance.now() - run.startedAt;
      run.firstMs ??= elapsed;
      if (shown.level === 0) run.lastMs ??= elapsed;
    }
    if (!this.undrawn) return;
    this.undrawn = false;
    this.refresh();
  }

  /**
   * Where server and viewer share their processors, the server leaves them to the first picture until it hears this. Not said
   * when the server was done before: nothing waits for it then, and a settled viewer sends nothing.
   */
  private async tellDrawn(generation: number): Promise<void> {
    if (this.scene.onGpu || !isLoopback(this.base.hostname)) return;
    await this.scene.finished();
    if (this.working && this.run?.generation === generation) this.client.drawn(generation);
  }

  private get busy(): boolean {
    return this.working || this.client.dirty || !this.pipeline.settled;
  }

  /**
   * From an edit to its picture: each new text is a frame of the page, which would delay the picture it tells of. The page
   * is then composed from the control under the hand to the status bar, and a processor takes as long for that as for the surface.
   */
  private refreshSoon(): void {
    this.refreshing ??= setTimeout(() => this.refresh(), PROGRESS_MS);
  }

  /** Brings the texts up to date; called after every event that is not one of many. */
  private refresh(): void {
    clearTimeout(this.refreshing);
    this.refreshing = undefined;
    const levels = this.scene.levelTriangles;
    const triangles = levels.reduce((sum, n) => sum + n, 0);
    this.displayBar.setLevelTriangles(levels);
    this.statusBar.set({
      connection: this.connection,
      working: this.busy,
      generation: this.shown?.generation,
      prefix: this.shown?.level,
      triangles,
      // Of the surface on screen only: a coarse prefix states none.
      error: this.busy || this.shown?.level !== 0 ? undefined : (this.statistics?.error ?? undefined),
      bytes: this.run?.bytes ?? 0,
      totalBytes: this.totalBytes,
      firstMs: this.run?.firstMs,
      lastMs: this.run?.lastMs,
      device: this.device,
    });
    const hint = this.hintText(triangles);
    this.hint.hidden = hint === "";
    setText(this.hint, hint);
  }

  private hintText(triangles: number): string {
    if (triangles > 0) return "";
    if (this.volumes?.length === 0) return "This server has no volumes";
    if (this.opening) {
      return `Opening ${this.volumes?.find((v) => v.id === this.target?.volume)?.title ?? this.target?.volume ?? ""}`;
    }
    if (this.connection !== "connected") return this.volume === undefined ? "Connecting to the server" : "";
    if (this.busy) return "Extracting the surface";
    if (this.shown?.level === 0 && this.edit !== undefined) {
      return `No surface at isovalue ${formatValue(this.edit.iso)}: no sample on one side of it`;
    }
    return "";
  }

  private status(): IsopeelStatus {
    const levelTriangles = this.scene.levelTriangles;
    return {
      connection: this.connection,
      volume: this.volume?.id,
      step: this.target?.step ?? 0,
      generation: this.shown?.generation,
      prefix: this.shown?.level,
      triangles: levelTriangles.reduce((sum, n) => sum + n, 0),
      levelTriangles,
      regions: this.scene.regionCount,
      settled: this.connection === "connected" && this.client.ready && this.shown?.level === 0 && !this.busy && !this.undrawn,
      statistics: this.statistics,
      edit: this.edit,
      framesSent: this.client.framesSent,
      framesDrawn: this.scene.framesDrawn,
      bytesReceived: this.totalBytes,
      undecoded: this.pipeline.undecoded,
      camera: { ...this.scene.pose, fitted: this.fitted },
      messages: this.toasts.texts,
    };
  }
}
