/** Joins the layers: events of page, stream and scene change the store, and page and scene show it. */

import { acknowledgeFrames } from "./wiring/acknowledging";
import { isEdit, isShared, otherActions, stateActions } from "./wiring/actions";
import { makeQuestions } from "./wiring/asking";
import { Cameras } from "./wiring/cameras";
import { AddressLink } from "./state/addressLink";
import { Comparison } from "./wiring/comparison";
import { Connecting } from "./wiring/connecting";
import { Display, FIRST_TABLES } from "./wiring/display";
import { embedOptions } from "./embed/origins";
import { Embedding } from "./wiring/embedding";
import { Summing } from "./wiring/summing";
import { Framing } from "./wiring/framing";
import { Later, once, whenReleased } from "./wiring/later";
import { streamAddress, streamUrl } from "./net/credentials";
import { StreamClient } from "./net/streamClient";
import { Marks } from "./wiring/marks";
import { Outputs } from "./wiring/outputs";
import type { StreamMessage, VolumeSummary } from "./protocol/types";
import type { Questions } from "./questions/questions";
import { RegionPipeline } from "./regions/pipeline";
import { statusOf } from "./wiring/status";
import { FileUploads } from "./wiring/uploading";
import { Timeline } from "./wiring/timeline";
import type { Storyteller } from "./wiring/storyteller";
import { pixelRatio } from "./scene/quality";
import { SurfaceRenderer } from "./scene/renderer";
import { withRanges } from "./state/featureRanges";
import { isAboutGroup, volumeOf } from "./state/group";
import { lengthScale } from "./state/lengths";
import { decodeLink, encodeLink, firstLink, linkState, type Link } from "./state/link";
import type { StateEvent } from "./state/reduce";
import { poseFor, stepOf, wantedOf, type State } from "./state/state";
import { Store } from "./state/store";
import { isAboutQuestion } from "./state/answers";
import { distancesOf } from "./state/distances";
import { shownErrors } from "./state/shownErrors";
import { hasSeveralServers, isCameraAwaited, isFollowingCamera, isFrameDue, isWorking, showsFinal } from "./state/viewer";
import type { UserEvent } from "./state/work";
import { SlicePlanes, slicesWanted } from "./wiring/slicePlanes";
import { Together } from "./wiring/together";
import { Model } from "./ui/model";
import { showPage } from "./ui/page";
import { installStatus } from "./ui/statusHook";
import { errorText, fewerText, unknownVolumeText } from "./ui/words";
import { followTheme } from "./ui/theme";

/** Delay of texts that follow frequent events: each change makes the browser compose the page, which delays the surface. */
const REFRESH_DELAY_MS = 250;

export class App {
  private readonly embedOptions = embedOptions(window.location.search, window.location.origin);
  private readonly store = new Store(this.embedOptions !== undefined);
  private readonly model = this.makeModel();
  private readonly scene: SurfaceRenderer;
  private readonly framing: Framing;
  private readonly cameras: Cameras;
  private readonly display: Display;
  private readonly outputs: Outputs;
  private readonly comparison: Comparison;
  private readonly marks: Marks;
  private readonly planes: SlicePlanes;
  private readonly pipeline: RegionPipeline;
  private readonly summing: Summing;
  private readonly client: StreamClient;
  private readonly address = new AddressLink({
    onLink: (link) => this.follow(link),
    onBroken: (reason) => this.model.toast(reason, "lasting"),
    link: () => (this.together.follows ? undefined : this.link()),
  });
  private readonly questions: Questions;
  private readonly connecting: Connecting;
  private readonly uploads: FileUploads;
  private readonly storyteller: () => Promise<Storyteller>;
  private readonly together: Together;
  /** Set if the page is embedded as a picture in another one. */
  private readonly embedding: Embedding | undefined;
  private readonly timeline: Timeline;
  private readonly later = new Later(REFRESH_DELAY_MS, () => this.refresh());

  /** @throws when the browser has no WebGL 2 */
  constructor(
    root: HTMLElement,
    private readonly base: URL,
  ) {
    const viewport = document.createElement("div");
    viewport.className = "viewport";
    this.scene = this.makeScene(viewport);
    this.framing = new Framing(this.scene, () => this.address.writeSoon());
    this.display = new Display(this.scene, this.base, (reason) => this.model.toast(reason), this.store.isEmbedded);
    this.marks = new Marks(this.scene);
    this.planes = new SlicePlanes(this.model.slices.set, this.base);
    this.comparison = new Comparison(this.scene, this.store, (comparing) => this.change({ type: "compare", comparing }));
    this.pipeline = this.makePipeline();
    const isStill = () => this.cameras.isStill;
    this.summing = new Summing(this.store, this.model, this.pipeline, isStill);
    this.client = this.makeClient();
    this.model.onGpu = this.scene.onGpu;
    this.connecting = new Connecting(this.model, this.base, (volumes) => this.showVolumes(volumes), () => this.embedding?.refused());
    this.uploads = new FileUploads(this.store, this.model, this.base, () => this.connecting.loadVolumes());
    const { store, model, scene, framing, pipeline, client } = this;
    const cameras = new Cameras({ store, scene, pixelRatio, framing, client, isLed: () => this.together.isCameraLed, isSettled: () => this.settled, onStill: () => this.later.soon() });
    this.cameras = cameras;
    this.outputs = new Outputs(model, store, scene, cameras, base);
    this.questions = makeQuestions({ store, model, scene, client, act: (event) => this.act(event), isStill }, viewport);
    const around = { store, model, scene, framing, cameras, isSettled: () => this.settled, link: () => this.link(), follow: (link: Link) => this.follow(link), base, reconnect: () => client.reconnect() };
    this.storyteller = once(async () => new (await import("./wiring/storyteller")).Storyteller({ ...around, decode: decodeLink, encode: encodeLink }));
    this.timeline = new Timeline({ ...around, pipeline, questions: this.questions, change: (event) => this.change(event), open: (volume, step) => this.open(volume, step) });
    this.together = this.makeTogether(viewport);
    if (this.embedOptions !== undefined) this.embedding = new Embedding(this.embedOptions, around);
    showPage(root, this.model, viewport, this.store.isEmbedded);
    followTheme((theme) => this.display.setTheme(theme));
    installStatus(() => statusOf({ store, model, scene, framing, pipeline, client }, this.settled));
    this.refresh();
  }

  start(): void {
    this.client.start();
  }

  private makeModel(): Model {
    const { store } = this;
    return new Model({
      openVolume: (id) => {
        if (this.together.mayChange()) this.open(id, stepOf(store.state, id));
      },
      ...stateActions(store, (event) => this.act(event)),
      ...otherActions(() => ({ store, model: this.model, framing: this.framing, cameras: this.cameras, base: this.base }), () => this.address.write()),
      group: (act) => this.together.act(act),
      story: (act) => act.type !== "add" && !this.together.mayChange() ? undefined : void this.storyteller().then((teller) => teller.act(act)),
      measureOverTime: (run) => this.together.mayChange() && this.timeline.measure(run),
      sumUp: () => this.summing.sumSelected(),
      useAtCentre: () => this.questions.useAtCentre(),
      retry: () => this.client.retryNow(),
      compare: (what) => (what === undefined ? this.comparison.end() : this.comparison.start(what)),
      saveImage: (request) => this.outputs.saveImage(request),
      saveTurn: (request, frames) => this.outputs.saveTurn(request, frames),
      retrySlices: () => this.planes.retry(),
    });
  }

  private makeScene(viewport: HTMLElement): SurfaceRenderer {
    return new SurfaceRenderer(viewport, FIRST_TABLES, {
      adaptsQuality: true,
      onResident: (id) => this.pipeline.resident(id),
      onFrame: () => this.frameRendered(),
      onClip: (clip) => {
        this.change({ type: "look", look: { clip }, gesture: "clip" });
        whenReleased(() => this.change({ type: "end-gesture" }));
      },
      onContextLost: () => {
        this.comparison.end();
        this.pipeline.clear();
        this.model.toast("Graphics context lost, restoring…");
      },
      onContextRestored: () => {
        this.model.clearErrors();
        this.client.restart();
      },
    });
  }

  private makePipeline(): RegionPipeline {
    return new RegionPipeline(new Worker(new URL("./decode/worker.ts", import.meta.url), { type: "module", name: "decode" }), this.scene, {
      onSwap: ({ surface, generation, level, final }) => {
        this.store.dispatch({ type: "swap", surface, generation, level, final });
        if (this.store.look.colorBy === "field") this.showDisplay();
        this.framing.swapped();
      },
      onAnnotated: ({ surface, generation, values }) => {
        this.store.dispatch({ type: "distances", surface, generation, distances: distancesOf(values, lengthScale(this.store.viewer.volume).spacing) });
        this.questions.annotated();
        this.showDisplay();
        this.refresh();
      },
      onBroken: (reason) => {
        this.model.toast(`${reason}. Starting over`);
        this.client.restart();
      },
    });
  }

  private makeTogether(viewport: HTMLElement): Together {
    const { store, model, scene, framing, client } = this;
    const does = { link: () => this.link(), change: (event: StateEvent) => this.change(event), alone: () => this.showVolumes(store.viewer.volumes ?? []) };
    return new Together({ store, model, scene, framing, client, ...does }, viewport);
  }

  private makeClient(): StreamClient {
    return new StreamClient((volume) => streamAddress(streamUrl(this.base, volume)), {
      wanted: () => wantedOf(this.store.state),
      linked: () => volumeOf(window.location.hash), hasSeveralServers: () => hasSeveralServers(this.store.viewer),
      onState: (state, reason) => {
        this.store.dispatch({ type: "connection", state });
        this.connecting.changed(state, reason);
        if (state !== "connected") this.together.lost();
        this.refresh();
      },
      onReset: () => void this.pipeline.event({ type: "reset" }),
      onMessage: (message) => this.receive(message),
      onChunk: (frame) => {
        this.store.dispatch({ type: "chunk", bytes: frame.byteLength });
        this.pipeline.chunk(frame);
        this.later.soon();
      },
      onBroken: (reason) => this.model.toast(`${reason}. Starting over`),
      onOnlyLooks: (reason) => this.model.refuse(reason),
      onEditSent: (surface) => {
        this.store.dispatch({ type: "sent", surface, at: performance.now() });
        this.questions.edited();
        this.showDisplay();
        this.later.soon();
      },
    });
  }

  /** @param wish the values of a link for the volume */
  private open(volume: string, step: number, wish?: Link): void {
    const { store, scene } = this;
    const leaving = volume === store.viewer.volume?.id ? undefined : { pose: scene.regionCount > 0 ? scene.camera.pose : undefined };
    const first = store.isEmbedded || store.state.wish !== undefined ? undefined : firstLink(store.state, volume);
    store.dispatch({ type: "open", target: { volume, step }, wish: wish ?? first, leaving });
    this.client.open();
    if (this.client.ready) for (const { number } of store.surfaces) store.dispatch({ type: "sent", surface: number, at: performance.now() });
    this.refresh();
  }

  /** An event of the user; if they may not do that, it is said why not. */
  private act(event: UserEvent): void {
    if (isShared(event) && !this.together.mayChange()) return;
    if (!isEdit(event) || this.model.mayEdit()) this.change(event);
  }

  /** Dispatches an event. Changes of view and look are sent to server and scene, and the page shows them at once. */
  private change(event: StateEvent): void {
    const { store } = this;
    const before = { ...store.work, state: store.state };
    store.dispatch(event);
    const { work, state } = store;
    if (state !== before.state) this.showDisplay();
    this.questions.follow();
    if (work.surfaces !== before.surfaces || state.comparing !== before.state.comparing) this.synchronise();
    if (work.step !== before.step) this.timeline.openStep();
    // Cards are about another surface.
    if (work.selected !== before.selected) this.refresh();
    this.model.showWork(store.state);
    this.together.changed();
    this.address.writeSoon();
    if (state.page !== before.state.page) this.timeline.follow();
  }

  /** Sends the state of the store to the server. */
  private synchronise(): void {
    this.client.follow();
    this.later.soon();
  }

  private showDisplay(): void {
    const { surfaces, look, page: { slicing }, view, viewer } = this.store;
    if (view === undefined || viewer.volume === undefined) return;
    const source = { volume: viewer.volume, step: viewer.target?.step ?? 0, field: slicing.field ?? view.field, slicing };
    this.marks.show(this.store);
    this.planes.show(slicesWanted(this.store), viewer.connection === "connected");
    this.display.show(look, withRanges(viewer, surfaces), viewer.selected, source, { distances: shownErrors(viewer, surfaces), known: viewer.known });
  }

  private receive(message: StreamMessage): void {
    const before = this.store.state;
    this.store.dispatch({ type: "message", message });
    if (this.questions.received(message) || isAboutQuestion(message)) return this.later.soon();
    if (this.together.receive(message) || isAboutGroup(message)) return this.refresh();
    switch (message.type) {
      case "opened":
        this.showVolume(before);
        break;
      case "stepped":
        this.comparison.end();
        this.showDisplay();
        return this.later.soon();
      case "described":
        this.model.showWork(this.store.state);
        break;
      case "prefix":
      case "committed":
      case "superseded":
      case "removed":
        this.pipeline.event(message);
        return this.later.soon();
      case "opening":
        return this.later.soon();
      case "annotated":
        this.pipeline.annotated(message);
        return this.later.soon();
      case "measured":
        break;
      case "done":
        this.cameras.changed();
        if (isFollowingCamera(this.store.viewer)) return this.later.soon();
        this.model.clearErrors();
        break;
      case "error":
        this.timeline.player.stop();
        if (message.code === "volume-removed") this.uploads.leaveRemoved();
        else this.model.toast(errorText(message, this.store.surfaces));
        break;
    }
    this.refresh();
  }

  /** Shows the volume that was opened: another one, or another step of the same one. */
  private showVolume(before: State): void {
    const { store, scene, pipeline } = this;
    const { volume } = store.viewer;
    if (volume === undefined) return;
    const another = volume.id !== before.server.volume?.id;
    this.comparison.end();
    if (another) pipeline.clear();
    this.framing.expect(another, another ? poseFor(before, volume.id) : undefined);
    scene.setGrid(volume.geometry);
    this.display.place(volume);
    const wished = before.wish?.volume === volume.id ? before.wish.surfaces.length : 0;
    if (wished > store.surfaces.length) this.model.toast(fewerText(store.surfaces.length), "lasting");
    pipeline.keep(store.surfaces.map(({ number }) => number));
    this.synchronise();
    this.showDisplay();
    document.title = `${volume.title} · isopeel`;
    this.model.showWork(store.state);
    this.together.take();
    this.address.writeSoon();
  }

  /** Shows the state of a link. */
  private follow(link: Link): void {
    const { volumes, volume, target } = this.store.viewer;
    // The list comes first.
    if (volumes === undefined) return;
    if (!volumes.some(({ id }) => id === link.volume)) {
      const first = target?.volume ?? volumes[0]?.id;
      this.model.toast(unknownVolumeText(this.store.viewer, link.volume, first), "lasting");
      if (target === undefined && first !== undefined) this.open(first, 0);
      return;
    }
    if (volume?.id === link.volume && target?.volume === link.volume) {
      this.change({ type: "replace", wish: link });
      if (link.pose !== undefined) this.scene.camera.restore(link.pose);
      return;
    }
    this.open(link.volume, link.step, link);
  }

  private readonly link = () => linkState(this.store.state, this.framing.pose);

  private showVolumes(volumes: readonly VolumeSummary[]): void {
    this.store.dispatch({ type: "volumes", volumes });
    const { target } = this.store.viewer;
    if (target === undefined && !this.together.join() && !this.address.read()) {
      if (volumes[0] !== undefined) this.open(volumes[0].id, 0);
    }
    this.refresh();
  }

  private frameRendered(): void {
    const before = this.store.viewer;
    this.store.dispatch({ type: "frame", at: performance.now() });
    const { store, scene, client, base } = this;
    acknowledgeFrames(before, { store, scene, client, base });
    this.together.changed();
    this.cameras.changed();
    if (isFrameDue(before)) this.later.soon();
    if (isFrameDue(before) && !isFollowingCamera(before)) this.refresh();
    // The camera may have moved.
    else this.address.writeSoon();
  }

  /** The server is done, and all of it is on screen. */
  private get settled(): boolean {
    const { viewer } = this.store;
    return viewer.connection === "connected" && this.client.ready && showsFinal(viewer) && !this.busy && this.pipeline.settled && !this.cameras.isDue && !isCameraAwaited(viewer);
  }

  private get busy(): boolean {
    const { viewer } = this.store;
    return isWorking(viewer) || this.client.dirty || (!this.pipeline.settled && !isFollowingCamera(viewer));
  }

  private refresh(): void {
    this.later.done();
    this.cameras.changed();
    this.questions.follow();
    this.summing.follow();
    this.comparison.advance(this.settled);
    this.showDisplay();
    this.timeline.follow();
    this.connecting.watch(this.store.viewer.watches);
    this.embedding?.follow(this.settled);
    const { levelTriangles, levelTrianglesBySurface } = this.scene;
    this.model.showProgress(this.store.state, { levelTriangles, levelTrianglesBySurface, busy: this.busy });
  }
}
