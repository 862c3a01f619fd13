/** Joins the layers: events of page, stream and scene change the state, and page and scene show it. */

import type { ConnectionState } from "./net/connection";
import { isLoopback } from "./net/loopback";
import { listVolumes } from "./net/rest";
import { StreamClient } from "./net/streamClient";
import { Throttle } from "./net/throttle";
import type { Edit, ServerMessage } from "./protocol/types";
import type { Swap } from "./regions/map";
import { RegionPipeline } from "./regions/pipeline";
import { SurfaceRenderer } from "./scene/renderer";
import { firstCoarseFrame, INITIAL_STATE, reduce, showsFinal, type ViewerEvent } from "./state/viewer";
import { complete } from "./state/view";
import { IMPORTANCE_STOPS, LEVEL_COLORS, rampLut, transferLut } from "./transfer/lut";
import { IDENTITY, sameImportance, toWire, type Points } from "./transfer/model";
import { Page } from "./ui/page";
import { installStatus, type IsopeelStatus } from "./ui/statusHook";
import { followTheme } from "./ui/theme";

/** Texts are brought up to date this long after an event of which there are many. */
const REFRESH_DELAY_MS = 250;
/** A dragged time slider opens a step at most this often: each step is read from disk. */
const STEP_INTERVAL_MS = 200;

export class App {
  private state = INITIAL_STATE;
  private readonly page: Page;
  private readonly scene: SurfaceRenderer;
  private readonly pipeline: RegionPipeline;
  private readonly client: StreamClient;
  private wantedStep = 0;
  private readonly stepThrottle = new Throttle(STEP_INTERVAL_MS, () => {
    const { target } = this.state;
    if (target !== undefined && target.step !== this.wantedStep) this.open(target.volume, this.wantedStep);
  });
  private refreshTimer: ReturnType<typeof setTimeout> | undefined;
  /** The next surface on screen is the first of its volume, and the camera is fitted to it. */
  private needsFit = true;
  private timesFitted = 0;

  /** @throws when the browser has no WebGL 2 */
  constructor(
    root: HTMLElement,
    private readonly base: URL,
  ) {
    this.page = this.makePage(root);
    this.scene = this.makeScene();
    this.pipeline = this.makePipeline();
    this.client = this.makeClient();
    followTheme((theme) => this.scene.setEdgeColor(theme === "dark" ? "#0b0e12" : "#101418"));
    installStatus(() => this.status());
    this.refresh();
  }

  start(): void {
    this.client.start();
  }

  private makePage(root: HTMLElement): Page {
    return new Page(root, {
      onVolume: (id) => {
        this.stepThrottle.cancel();
        this.open(id, 0);
      },
      onStep: (step) => {
        this.wantedStep = step;
        this.stepThrottle.call();
      },
      onEdit: (edit) => this.edit(edit),
      onPoints: (points) => this.editPoints(points),
      onColorMode: (mode) => this.scene.setColorMode(mode),
      onWireframe: (on) => this.scene.setWireframe(on),
      onFinestLevel: (level) => this.scene.setFinestLevel(level),
      onFit: () => this.fit(false),
      onRetry: () => this.client.retryNow(),
    });
  }

  private makeScene(): SurfaceRenderer {
    const tables = { transfer: transferLut(IDENTITY), importance: rampLut(IMPORTANCE_STOPS), levels: LEVEL_COLORS };
    return new SurfaceRenderer(this.page.viewport, tables, {
      onResident: (id) => this.pipeline.resident(id),
      onFrame: () => this.frameRendered(),
      onContextLost: () => {
        this.pipeline.clear();
        this.page.toasts.show("The graphics device was reset; the picture comes back when it does");
      },
      onContextRestored: () => {
        this.page.toasts.clear();
        this.client.restart();
      },
    });
  }

  private makePipeline(): RegionPipeline {
    const worker = new Worker(new URL("./decode/worker.ts", import.meta.url), { type: "module", name: "decode" });
    return new RegionPipeline(worker, this.scene, {
      onSwap: (swap) => this.swapped(swap),
      onBroken: (reason) => {
        this.reportBroken(reason);
        this.client.restart();
      },
    });
  }

  private makeClient(): StreamClient {
    const url = new URL("api/v1/stream", this.base);
    url.protocol = this.base.protocol === "https:" ? "wss:" : "ws:";
    return new StreamClient(url.href, {
      onState: (state, reason) => this.connectionChanged(state, reason),
      onReset: () => void this.pipeline.event({ type: "reset" }),
      onMessage: (message) => this.receive(message),
      onChunk: (frame) => {
        this.update({ type: "chunk", bytes: frame.byteLength });
        this.pipeline.chunk(frame);
        this.refreshSoon();
      },
      onBroken: (reason) => this.reportBroken(reason),
      onEditSent: () => {
        this.update({ type: "sent", at: performance.now() });
        this.refreshSoon();
      },
    });
  }

  private update(event: ViewerEvent): void {
    this.state = reduce(this.state, event);
  }

  private open(volume: string, step: number): void {
    const { volumes } = this.state;
    this.update({ type: "open", target: { volume, step } });
    if (volumes !== undefined) this.page.panel.setVolumes(volumes, volume);
    const address = new URL(window.location.href);
    address.hash = new URLSearchParams({ volume }).toString();
    window.history.replaceState(null, "", address);
    this.client.open(volume, step);
    this.refresh();
  }

  private edit(edit: Edit): void {
    if (this.state.view === undefined) return;
    const whole = complete(edit);
    this.update({ type: "edit", edit: whole });
    this.page.panel.setView(this.state.view);
    this.scene.setAlpha(this.state.view.alpha);
    this.client.edit(whole);
    this.refreshSoon();
  }

  private editPoints(points: Points): void {
    this.scene.setTransfer(transferLut(points));
    const { view } = this.state;
    if (view === undefined) return;
    const transferFunction = toWire(points);
    this.update({ type: "edit", edit: { transferFunction } });
    // Colours are looked up in the shader: nothing leaves the browser.
    if (sameImportance(view.transferFunction.points, transferFunction.points)) this.client.remember({ transferFunction });
    else this.client.edit({ transferFunction });
    this.refreshSoon();
  }

  private receive(message: ServerMessage): void {
    const volumeBefore = this.state.volume?.id;
    this.update({ type: "message", message });
    switch (message.type) {
      case "opened":
        this.showVolume(message.step, message.volume.id !== volumeBefore);
        break;
      case "prefix":
      case "committed":
      case "superseded":
        this.pipeline.event(message);
        return this.refreshSoon();
      case "opening":
        return this.refreshSoon();
      case "measured":
        this.page.panel.setStatistics(this.state.statistics);
        break;
      case "done":
        this.page.panel.setStatistics(message.statistics);
        this.page.toasts.clear();
        break;
      case "error":
        this.page.toasts.show(message.message);
        break;
    }
    this.refresh();
  }

  /** Shows the volume that was opened: `another` volume, or another step of the same one. */
  private showVolume(step: number, another: boolean): void {
    const { volume, view } = this.state;
    if (volume === undefined || view === undefined) return;
    const { panel } = this.page;
    if (another) {
      this.pipeline.clear();
      panel.setStatistics(undefined);
      this.needsFit = true;
    }
    this.scene.setGrid(volume.geometry);
    panel.setVolume(volume, step);
    panel.setView(view);
    // After a reconnection the points are the user's own, and so is their history.
    if (another) panel.editor.replace(view.transferFunction.points);
    this.scene.setTransfer(transferLut(panel.editor.points));
    this.scene.setAlpha(view.alpha);
    this.page.setNotice(volume.notice ?? "");
    document.title = `${volume.title} · isopeel`;
  }

  private reportBroken(reason: string): void {
    this.page.toasts.show(`${reason}. Starting over`);
  }

  private connectionChanged(state: ConnectionState, reason: string | undefined): void {
    this.update({ type: "connection", state });
    if (state === "connected") {
      this.page.banner.connected();
      void this.loadVolumes();
    } else {
      this.page.banner.disconnected(state === "waiting" ? reason : undefined);
    }
    this.refresh();
  }

  private async loadVolumes(): Promise<void> {
    try {
      this.update({ type: "volumes", volumes: await listVolumes(this.base) });
    } catch (error) {
      this.page.toasts.show(`The list of volumes could not be read: ${error instanceof Error ? error.message : String(error)}`);
      return;
    }
    const { volumes = [], target } = this.state;
    this.page.panel.setVolumes(volumes, target?.volume);
    if (target === undefined) {
      const named = new URLSearchParams(window.location.hash.slice(1)).get("volume");
      const first = volumes.find((v) => v.id === named) ?? volumes[0];
      if (first !== undefined) this.open(first.id, 0);
    }
    this.refresh();
  }

  private fit(fromFirstDirection: boolean): void {
    this.scene.fit(fromFirstDirection);
    this.timesFitted += 1;
  }

  private swapped({ generation, level, final }: Swap): void {
    this.update({ type: "swap", generation, level, final });
    if (!this.needsFit || this.scene.regionCount === 0) return;
    this.needsFit = false;
    this.fit(true);
  }

  private frameRendered(): void {
    const before = this.state;
    this.update({ type: "frame", at: performance.now() });
    const generation = firstCoarseFrame(before, this.state);
    if (generation !== undefined) void this.acknowledge(generation);
    if (before.frameDue) this.refresh();
  }

  /**
   * Tells a server on this machine that an edit's first frame is rendered. Without a GPU both work on the same processors: the
   * server leaves them to the viewer until then. Not sent when the server is done already, for nothing waits for it then.
   */
  private async acknowledge(generation: number): Promise<void> {
    if (this.scene.onGpu || !isLoopback(this.base.hostname)) return;
    await this.scene.finished();
    const { working, progress } = this.state;
    if (working && progress?.generation === generation) this.client.acknowledge(generation);
  }

  private get busy(): boolean {
    return this.state.working || this.client.dirty || !this.pipeline.settled;
  }

  /**
   * Brings the texts up to date a little later, for events of which there are many between an edit and its frame. Each change of
   * a text makes the browser compose the page again, which takes a processor as long as rendering the surface, and delays it.
   */
  private refreshSoon(): void {
    this.refreshTimer ??= setTimeout(() => this.refresh(), REFRESH_DELAY_MS);
  }

  private refresh(): void {
    clearTimeout(this.refreshTimer);
    this.refreshTimer = undefined;
    this.page.update(this.state, { levelTriangles: this.scene.levelTriangles, busy: this.busy });
  }

  private status(): IsopeelStatus {
    const { state, scene, client } = this;
    const { levelTriangles } = scene;
    return {
      connection: state.connection,
      volume: state.volume?.id,
      step: state.target?.step ?? 0,
      generation: state.shown?.generation,
      prefix: state.shown?.level,
      triangles: levelTriangles.reduce((sum, n) => sum + n, 0),
      levelTriangles,
      regions: scene.regionCount,
      settled: state.connection === "connected" && client.ready && showsFinal(state) && !this.busy,
      statistics: state.statistics,
      edit: state.view,
      framesSent: client.framesSent,
      framesDrawn: scene.framesRendered,
      bytesReceived: state.bytesReceived,
      undecoded: this.pipeline.undecoded,
      camera: { ...scene.pose, fitted: this.timesFitted },
      messages: this.page.toasts.texts,
    };
  }
}
