/**
 * The whole state of the page: what the server says (`viewer`), what the user made of the open volume (`work`, with one history of
 * it), and the layers of the page. Each volume keeps its own work while another one is open. Pure except for its listeners.
 */

import type { Edit, Vec3, View } from "../protocol/types";
import { History } from "./history";
import { DEFAULT_LOOK, openingLook, type Look, type Pose } from "./look";
import type { MeasureKind } from "./measure";
import { PARTS_GESTURE, placesOf, type PartTool } from "./parts";
import { ofItsField } from "./fields";
import { FIRST_SLICING, planesAt, type Slicing } from "./slicing";
import type { Story } from "./story";
import { added, besides, DEFAULT_STYLE, edited, limited, listOf, removed, styled, type Surface, type SurfaceList, type SurfaceStyle } from "./surfaceList";
import { INITIAL_STATE, reduce, type ViewerEvent, type ViewerState } from "./viewer";

/** What undo and redo cover. */
export interface Work {
  readonly surfaces: SurfaceList;
  /** Number of the surface that edits are of. Selecting another one is no step of the history, but a step brings its own back. */
  readonly selected: number;
  readonly look: Look;
  /** Time step. */
  readonly step: number;
}

/** What a click on the surface does besides turning it: a point for the editor at its value, a region of interest there, a part
 * of the surface that goes or stays alone, or a measurement. */
export type Tool = "pick" | "paint" | PartTool | MeasureKind;

/** Layers of the page. */
export interface PageLayers {
  readonly inspector: boolean;
  /** The card in the sheet of a narrow page. */
  readonly sheet: string | undefined;
  /** Cards that are folded, and cards that were unfolded by hand, by their ids. */
  readonly folded: Readonly<Record<string, boolean>>;
  readonly tool: Tool | undefined;
  /** Points of what is being measured. */
  readonly picked: readonly Vec3[];
  /** Parts that are kept, while all are shown so that another one can be chosen. */
  readonly kept: readonly Vec3[];
  /** Which regions of interest are outlined in the picture: all, or all and one of them, by its number, more than the others. */
  readonly outlined: "all" | number | undefined;
  /** Radius of the regions that are marked, world units; `undefined`: a share of the volume. */
  readonly brush: number | undefined;
  readonly player: Player;
  /** Slices beside the picture. */
  readonly slicing: Slicing;
  /** Bookmarks, of all volumes. */
  readonly story: Story;
}

/** How time steps are played. */
interface Player {
  readonly playing: boolean;
  /** Steps in a second at most. */
  readonly speed: number;
  /** The first step follows the last one. */
  readonly loop: boolean;
}

/** Until the user chooses: slow enough to see each step. */
const FIRST_PLAYER: Player = { playing: false, speed: 5, loop: true };

/** The radius of the brush until another one is chosen, as a share of the volume's longest side. */
const FIRST_BRUSH = 0.05;

/** State of a volume that is kept while another one is open. */
interface Remembered {
  readonly history: History<Work>;
  readonly step: number;
  readonly pose: Pose | undefined;
  readonly crosshair: Slicing["at"];
}

/** What a link asks for, once the volume is open. What is not named is as the volume opens. */
export interface Wish {
  readonly surfaces: readonly { readonly edit: Edit; readonly style: Partial<SurfaceStyle> }[];
  /** Place of the selected one among them. */
  readonly selected: number;
  readonly look: Partial<Look>;
  readonly pose: Pose | undefined;
  readonly step?: number;
  readonly slicing?: Slicing;
  /** Without one the bookmarks stay. */
  readonly story?: Story;
}

export class Store {
  private viewerState = INITIAL_STATE;
  private history: History<Work> | undefined;
  /** The server's own values of the open volume: a link names what differs from them. */
  private openingView: View | undefined;
  private layers: PageLayers = {
    inspector: true,
    sheet: undefined,
    folded: {},
    tool: undefined,
    picked: [],
    kept: [],
    outlined: undefined,
    brush: undefined,
    player: FIRST_PLAYER,
    slicing: FIRST_SLICING,
    story: [],
  };
  private readonly remembered = new Map<string, Remembered>();

  /** @param isEmbedded the page is a picture in another one, without cards */
  constructor(readonly isEmbedded = false) {}

  get viewer(): ViewerState {
    return this.viewerState;
  }

  /** Of the selected surface. */
  get view(): View | undefined {
    return this.viewerState.view;
  }

  /** None until a volume is open. */
  get surfaces(): SurfaceList {
    return this.work?.surfaces ?? [];
  }

  /** The surface that edits are of. */
  get surface(): Surface | undefined {
    return this.surfaces.find(({ number }) => number === this.work?.selected);
  }

  /** What undo and redo cover, now. */
  get work(): Work | undefined {
    return this.history?.current;
  }

  /** The time step that is wanted. */
  get step(): number {
    return this.history?.current.step ?? 0;
  }

  get look(): Look {
    return this.history?.current.look ?? DEFAULT_LOOK;
  }

  get page(): PageLayers {
    return this.layers;
  }

  /** The volume's longest side, world units. */
  get extent(): number {
    const { dims, spacing } = this.viewerState.volume?.geometry ?? { dims: [2], spacing: [1] };
    return Math.max(...dims.map((n, axis) => (n - 1) * (spacing[axis] ?? 1)));
  }

  /** Radius of the regions of interest that are marked, world units. */
  get brush(): number {
    return this.layers.brush ?? Number((FIRST_BRUSH * this.extent).toPrecision(2));
  }

  get opening(): View | undefined {
    return this.openingView;
  }

  /** How the open volume is shown first. */
  get openingLook(): Look {
    return this.viewerState.volume === undefined ? DEFAULT_LOOK : openingLook(this.viewerState.volume);
  }

  get canUndo(): boolean {
    return this.history?.canUndo ?? false;
  }

  get canRedo(): boolean {
    return this.history?.canRedo ?? false;
  }

  /** An event of server, scene or connection. */
  dispatch(event: ViewerEvent): void {
    this.viewerState = reduce(this.viewerState, event);
  }

  changePage(layers: Partial<PageLayers>): void {
    // What was begun with a tool ends with it.
    const isOther = "tool" in layers && layers.tool !== this.layers.tool;
    if (isOther) this.hideOthersAgain();
    if (layers.slicing?.layout === "picture") this.leavePlanes();
    this.layers = { ...this.layers, ...(isOther ? { picked: [] } : {}), ...layers };
    if (isOther && layers.tool === "keep-another") this.showOthers();
  }

  /** Slices in the picture stay at the last place of the crosshair. */
  private leavePlanes(): void {
    const { history, viewerState: { volume } } = this;
    if (history === undefined || volume === undefined || this.layers.slicing.layout === "picture") return;
    const { look } = history.current;
    const planes = planesAt(look.slices.planes, this.layers.slicing, volume.geometry.dims);
    history.amend({ ...history.current, look: { ...look, slices: { ...look.slices, planes } } });
  }

  /** All parts are shown beside those that are kept, until one of them is chosen or the tool is put down. */
  private showOthers(): void {
    this.layers = { ...this.layers, kept: placesOf(this.view?.parts ?? null) };
    this.edit({ parts: null }, PARTS_GESTURE);
  }

  /** None was chosen: as before. */
  private hideOthersAgain(): void {
    if (this.layers.kept.length > 0 && this.history?.cancel(PARTS_GESTURE) === true) this.arrange();
    this.layers = { ...this.layers, kept: [] };
  }

  /** Keeps the open volume's work, before another one is opened. */
  leave(pose: Pose | undefined): void {
    const { volume } = this.viewerState;
    if (volume === undefined || this.history === undefined) return;
    this.hideOthersAgain();
    this.history.end();
    this.remembered.set(volume.id, { history: this.history, step: this.step, pose, crosshair: this.layers.slicing.at });
  }

  /** Whether there is work of a volume, open or left. */
  knows(volume: string): boolean {
    return this.viewerState.volume?.id === volume || this.remembered.has(volume);
  }

  /** The step at which a volume was left. */
  stepOf(volume: string): number {
    return this.remembered.get(volume)?.step ?? 0;
  }

  /**
   * A volume was opened and `dispatch` has taken up its values.
   * @param another it is not the one before: its own work, that of a link, or what is remembered of it begins
   * @returns the pose that the camera shall have, if that is known
   */
  opened(another: boolean, wish: Wish | undefined): Pose | undefined {
    const { view, volume, target } = this.viewerState;
    if (view === undefined || volume === undefined) return undefined;
    const step = target?.step ?? 0;
    if (!another) {
      this.arrange();
      return undefined;
    }
    this.openingView = view;
    // A radius and places of another world.
    this.changePage({ brush: undefined, picked: [], kept: [], player: { ...this.layers.player, playing: false } });
    const kept = this.remembered.get(volume.id);
    // Not `changePage`: the history is still that of the volume before.
    const slicing = wish === undefined ? { ...this.layers.slicing, field: undefined, at: kept?.crosshair } : (wish.slicing ?? FIRST_SLICING);
    this.layers = { ...this.layers, slicing, story: wish?.story ?? this.layers.story };
    const wished = wish && this.wished(wish, view);
    const first: Work = { surfaces: [{ number: 0, view, style: DEFAULT_STYLE }], selected: 0, look: this.openingLook, step };
    this.history = kept?.history ?? new History<Work>(wished ?? first);
    if (wished !== undefined && kept !== undefined) this.history.set(wished);
    this.history.amend({ ...this.history.current, step });
    this.arrange();
    return wish === undefined ? kept?.pose : wish.pose;
  }

  /** An edit of the user. Edits of one `gesture` (a slider being dragged) are one step of the history until `endGesture`. */
  edit(edit: Edit, gesture?: string): void {
    this.change(({ surfaces, selected, look }) => {
      const isOther = edit.feature !== undefined && edit.feature !== this.view?.feature && look.colorRange !== undefined;
      // A range of colours is one of the field's values.
      return { surfaces: edited(surfaces, selected, edit), ...(isOther ? { look: { ...look, colorRange: undefined } } : {}) };
    }, gesture);
  }

  changeLook(look: Partial<Look>, gesture?: string): void {
    this.change((work) => ({ look: { ...work.look, ...look } }), gesture);
  }

  changeStyle(number: number, style: Partial<SurfaceStyle>, gesture?: string): void {
    this.change(({ surfaces }) => ({ surfaces: styled(surfaces, number, style) }), gesture);
  }

  /** To another time step. All that are played or dragged through are one step of the history. */
  goTo(step: number, gesture?: string): void {
    if (step !== this.step) this.change(() => ({ step }), gesture);
  }

  /** A surface at another isovalue, else like the selected one; it is selected then. */
  addSurface(iso: number): void {
    this.change(({ surfaces }) => {
      const { surface } = this;
      if (surface === undefined || surfaces.length >= this.viewerState.maxSurfaces) return {};
      const all = added(surfaces, surface, iso);
      return { surfaces: all, selected: all.at(-1)?.number ?? 0 };
    });
  }

  /** Several surfaces at once, as one step. `undefined`: they stay as they are. */
  arrangeSurfaces(act: (surfaces: SurfaceList, opening: View) => SurfaceList | undefined): void {
    this.change(({ surfaces }) => {
      const list = this.openingView && act(surfaces, this.openingView);
      return list === undefined ? {} : { surfaces: list };
    });
  }

  /** The last one stays. */
  removeSurface(number: number): void {
    this.change(({ surfaces, selected }) => {
      if (surfaces.length < 2) return {};
      return { surfaces: removed(surfaces, number), selected: selected === number ? besides(surfaces, number) : selected };
    });
  }

  /** Edits are of this surface from now on. */
  select(number: number): void {
    const { history } = this;
    if (history === undefined || this.surfaces.every((surface) => surface.number !== number)) return;
    this.hideOthersAgain();
    history.end();
    history.amend({ ...history.current, selected: number });
    this.arrange();
  }

  /** All of it at once, as one step: what a link asks for. */
  replace(wish: Omit<Wish, "pose">): void {
    const { openingView } = this;
    if (openingView === undefined) return;
    this.changePage({ slicing: wish.slicing ?? FIRST_SLICING, story: wish.story ?? this.layers.story });
    this.change(() => this.wished(wish, openingView));
  }

  /** What the one in control shows, in place of what is shown: no step of the history. Without `slicing` the slices stay. */
  adopt(work: Work, slicing = this.layers.slicing): void {
    const { history } = this;
    if (history === undefined) return;
    history.end();
    history.amend(work);
    this.layers = { ...this.layers, slicing };
    this.arrange();
  }

  endGesture(): void {
    this.history?.end();
  }

  /** As before the gesture of this name, if it is under way. */
  cancelGesture(name: string): void {
    if (this.history?.cancel(name) === true) this.arrange();
  }

  undo(): void {
    if (this.history?.undo() === true) this.arrange();
  }

  redo(): void {
    if (this.history?.redo() === true) this.arrange();
  }

  private wished({ surfaces, selected, look, step }: Omit<Wish, "pose">, opening: View): Work {
    const { volume } = this.viewerState;
    const list = listOf(
      opening,
      surfaces.map(({ edit, style }) => ({ edit: ofItsField(edit, opening, volume), style })),
    );
    return { surfaces: list, selected: list[selected]?.number ?? 0, look: { ...this.openingLook, ...look }, step: step ?? this.step };
  }

  private change(act: (work: Work) => Partial<Work>, gesture?: string): void {
    const { history } = this;
    if (history === undefined) return;
    const changed = act(history.current);
    if (Object.keys(changed).length === 0) return;
    const work = { ...history.current, ...changed };
    if (gesture === undefined) history.set(work);
    else history.drag(work, gesture);
    this.arrange();
  }

  /** The viewer knows of the surfaces as they are now. A server that allows fewer than there are shows the first ones. */
  private arrange(): void {
    const { history, viewerState } = this;
    if (history === undefined) return;
    const { surfaces, selected } = history.current;
    const list = limited(surfaces, viewerState.maxSurfaces);
    const at = surfaces.findIndex(({ number }) => number === selected);
    if (list !== surfaces) history.amend({ ...history.current, surfaces: list, selected: (list[at] ?? list[0])?.number ?? 0 });
    this.dispatch({ type: "surfaces", surfaces: list, selected: history.current.selected });
  }
}
