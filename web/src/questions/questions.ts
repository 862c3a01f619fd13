/** Joins stream, scene and page to ask questions about the surface on screen. */

import type { Curve, Distribution, Probed, Question, ServerMessage, Vec3 } from "../protocol/types";
import { dueQuestions, type DueQuestion } from "../state/answers";
import { MAX_REGIONS, paint } from "../state/interest";
import { MAX_MEASURES, measureOf, shortened, type Measure } from "../state/measure";
import { dueErrors } from "../state/shownErrors";
import { choosePart, isKept, PARTS_GESTURE, placesOf, type PartTool } from "../state/parts";
import { brushOf } from "../state/state";
import type { Store } from "../state/store";
import type { UserEvent } from "../state/work";
import { Asker } from "./asker";
import { centreOf, listenToPicture } from "./pointer";
import { Prober, type Place, type ProberHandlers } from "./prober";

/** Callbacks of the page. */
export interface QuestionPage {
  readonly showProbe: (probed: Probed | undefined) => void;
  /** Dispatches an event and shows what it changes, if the user may do that. */
  readonly act: (event: UserEvent) => void;
  /** Adds a point of the transfer function at this value. */
  readonly addPoint: (blended: number) => void;
  /** The crosshair of the slices goes there. */
  readonly point: (position: Vec3) => void;
  /** Whether the camera is still. While it moves, each surface is soon replaced. */
  readonly isStill: () => boolean;
  /** Explains why a click did nothing. */
  readonly say: (text: string) => void;
}

const NOTHING_THERE = "No surface there: click on the surface itself";
/** Tools are for the surface that edits are of. */
const ANOTHER_THERE = "That is another surface: select it under Surface first";

export class Questions {
  private readonly asker: Asker;
  private readonly prober: Prober;
  private viewport: HTMLElement | undefined;

  constructor(
    private readonly store: Store,
    ask: (question: Question) => void,
    pick: ProberHandlers["pick"],
    private readonly page: QuestionPage,
  ) {
    this.asker = new Asker(() => this.due(), ask);
    this.prober = new Prober({ pick, ask, onProbed: page.showProbe });
  }

  /** Listens to the pointer over the picture. */
  listen(viewport: HTMLElement): void {
    this.viewport = viewport;
    listenToPicture(viewport, {
      onHover: (place) => {
        if (this.canProbe) this.prober.hover(place);
      },
      onLeave: () => this.prober.leave(),
      onClick: (place) => void this.use(place),
      onEscape: () => this.page.act({ type: "page", layers: { tool: undefined } }),
    });
  }

  /** Uses the current tool at the centre of the picture: for keys and touch. */
  useAtCentre(): void {
    if (this.viewport !== undefined) void this.use(centreOf(this.viewport));
  }

  /** Probes a place of the world. */
  probeAt(position: Vec3, surface: number): Promise<Probed | undefined> {
    return this.prober.at({ position, surface });
  }

  /** State or surface changed. */
  follow(): void {
    this.asker.follow();
  }

  /** An edit was sent. */
  edited(): void {
    this.asker.edited();
  }

  /** An annotation is complete, and the state contains it. */
  annotated(): void {
    this.asker.answered("annotate");
  }

  /** A message that the state has processed. Returns whether it is an answer that needs no further processing. */
  received(message: ServerMessage): message is Curve | Distribution | Probed {
    if (message.type === "opened") this.asker.reset();
    if (message.type === "probed") this.prober.answered(message);
    const isCurve = message.type === "curve" || message.type === "distribution";
    if (isCurve) this.asker.answered(message.type);
    return isCurve || message.type === "probed";
  }

  /**
   * Questions whose answers are missing: for the cards of the selected surface, and, if colours show distances, for the surfaces that have
   * these colours.
   */
  private due(): readonly DueQuestion[] {
    const { isEmbedded, look, surfaces, viewer } = this.store;
    // The curve is that of all cameras.
    if (!this.page.isStill()) return isEmbedded ? [] : dueQuestions(viewer, ["curve"]);
    return [...(isEmbedded ? [] : dueQuestions(viewer, ["curve", "distribution"])), ...(look.colorBy === "error" ? dueErrors(viewer, surfaces) : [])];
  }

  /** Whether to probe: not while the surface is being made, because a probe renders it too. An embedded page does not show probes. */
  private get canProbe(): boolean {
    const { questions, working, shown } = this.store.viewer;
    return !this.store.isEmbedded && questions.includes("probe") && !working && shown?.final === true;
  }

  private async use(place: Place): Promise<void> {
    const { tool, slicing } = this.store.page;
    if (tool === undefined && slicing.layout === "both" && !this.store.isEmbedded) await this.pointAt(place);
    if (tool === "pick") await this.pickValue(place);
    if (tool === "paint") await this.paintRegion(place);
    if (tool === "distance" || tool === "angle") await this.measure(place, tool);
    if (tool === "reading") await this.read(place);
    if (tool === "label") await this.label(place);
    if (tool === "hide-part" || tool === "keep-part" || tool === "keep-another") await this.choosePart(place, tool);
  }

  /** A click that meets no surface moves nothing. */
  private async pointAt(place: Place): Promise<void> {
    const found = await this.prober.locate(place);
    if (found !== undefined) this.page.point(found.position);
  }

  private async measure(place: Place, kind: "distance" | "angle"): Promise<void> {
    const found = await this.prober.locate(place);
    if (found === undefined) return this.page.say(NOTHING_THERE);
    // The tool may have been put down meanwhile.
    if (this.store.page.tool !== kind) return;
    const points = [...this.store.page.picked, shortened(found.position)];
    const measure = measureOf(kind, points);
    this.page.act({ type: "page", layers: { picked: measure === undefined ? points : [] } });
    if (measure !== undefined) this.addMeasure(measure);
  }

  /** The values of all fields, as the server interpolates them. */
  private async read(place: Place): Promise<void> {
    const probed = await this.prober.probe(place);
    if (probed === undefined) return this.page.say(NOTHING_THERE);
    const fields = this.store.viewer.volume?.fields ?? [];
    const values = fields.map(({ name }) => probed.values.find(({ field }) => field === name)?.value ?? null);
    this.addMeasure({ kind: "reading", points: [shortened(probed.position)], values });
  }

  /** Its text is changed in the list. */
  private async label(place: Place): Promise<void> {
    const found = await this.prober.locate(place);
    if (found === undefined) return this.page.say(NOTHING_THERE);
    if (this.store.page.tool !== "label") return;
    const count = this.store.look.measures.filter(({ kind }) => kind === "label").length;
    this.addMeasure({ kind: "label", points: [shortened(found.position)], text: `Label ${count + 1}` });
  }

  private addMeasure(measure: Measure): void {
    const { measures } = this.store.look;
    if (measures.length >= MAX_MEASURES) return this.page.say(`There are ${MAX_MEASURES} measurements, and no more are taken: remove some`);
    this.page.act({ type: "look", look: { measures: [...measures, measure] } });
  }

  private async pickValue(place: Place): Promise<void> {
    const probed = await this.prober.probe(place);
    const blended = probed?.nearest?.blended;
    if (blended === undefined) return this.page.say(NOTHING_THERE);
    if (probed?.surface !== this.store.viewer.selected) return this.page.say(ANOTHER_THERE);
    this.page.showProbe(probed);
    this.page.addPoint(blended);
  }

  private async paintRegion(place: Place): Promise<void> {
    const found = await this.prober.locate(place);
    if (found === undefined) return this.page.say(NOTHING_THERE);
    if (found.surface !== this.store.viewer.selected) return this.page.say(ANOTHER_THERE);
    this.addRegion(shortened(found.position));
  }

  /** The server says whether a part is there: on a coarse surface a place may be too far from the full one. */
  private async choosePart(place: Place, tool: PartTool): Promise<void> {
    const probed = await this.prober.probe(place);
    if (probed === undefined) return this.page.say(NOTHING_THERE);
    if (probed.surface !== this.store.viewer.selected) return this.page.say(ANOTHER_THERE);
    const { view, page } = this.store;
    const { nearest } = probed;
    if (nearest === null) return this.page.say("The full surface is too far from there: click elsewhere on this part");
    const isHidden = nearest.leaf === null && nearest.partArea !== null;
    if (isHidden) return this.page.say("What is nearest there is hidden already: click elsewhere on this part");
    const places = page.kept.length > 0 || view === undefined || !isKept(view.parts) ? page.kept : placesOf(view.parts);
    const numbers = await this.prober.partsAt(places, probed.surface);
    // The tool may have been put down meanwhile, and the surface changed.
    if (view === undefined || this.store.page.tool !== tool || this.store.view !== view) return;
    const parts = choosePart(view.parts, tool, { at: shortened(probed.position), number: nearest.part ?? null }, { places, numbers });
    if (typeof parts === "string") return this.page.say(parts);
    this.page.act({ type: "edit", edit: { parts }, gesture: PARTS_GESTURE });
    this.page.act({ type: "end-gesture" });
    // One that is chosen beside others is one of them now.
    if (tool === "keep-another") this.page.act({ type: "page", layers: { tool: undefined, kept: [] } });
  }

  private addRegion(position: Vec3): void {
    const { view, state } = this.store;
    if (view === undefined) return;
    const interest = paint(view.interest, position, brushOf(state));
    if (interest === view.interest) return this.page.say(`There are ${MAX_REGIONS} regions, and no more are taken: remove some`);
    this.page.act({ type: "edit", edit: { interest } });
  }
}
