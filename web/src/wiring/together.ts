/** A group on this page: what is shown here goes to those who follow, or what another shows is shown here. */

import { keepLeading, takeLeading } from "../net/leading";
import type { StreamClient } from "../net/streamClient";
import { Throttle } from "../net/throttle";
import { isEqual } from "../protocol/equal";
import type { Led, Posed, ServerMessage, View } from "../protocol/types";
import type { CameraPose } from "../scene/pose";
import type { SurfaceRenderer } from "../scene/renderer";
import { groupLink, groupNews, groupOf, isLed, volumeOf, type GroupAct, type GroupState } from "../state/group";
import { decodeLink, encodeLink, type Link, type LinkState } from "../state/link";
import { LinkError } from "../state/linkReader";
import { FIRST_SLICING } from "../state/slicing";
import type { StateEvent } from "../state/reduce";
import { openingLookOf } from "../state/state";
import { hasSeveralServers } from "../state/viewer";
import type { Store } from "../state/store";
import { DEFAULT_STYLE } from "../state/surfaceList";
import { sorted } from "../transfer/model";
import type { Model } from "../ui/model";
import { copyOut } from "../ui/takeAlong";
import type { Framing } from "./framing";

/** As often as the server passes them on. */
const POSE_INTERVAL_MS = 50;
/** A longer look is kept to oneself: the server takes no more. */
const MAX_PAGE_CHARS = 12_000;

interface Around {
  readonly store: Store;
  readonly model: Model;
  readonly scene: SurfaceRenderer;
  readonly framing: Framing;
  readonly client: StreamClient;
  readonly link: () => LinkState | undefined;
  /** Dispatches an event, and shows what it has changed. */
  readonly change: (event: StateEvent) => void;
  /** There is nothing to follow: something else is to be opened. */
  readonly alone: () => void;
}

export class Together {
  private led: Led | undefined;
  private posed: Posed | undefined;
  /** On this connection. */
  private isIn = false;
  private sentPage = "";
  private sentCamera: CameraPose | undefined;
  private name: string | undefined;
  private readonly throttle = new Throttle(POSE_INTERVAL_MS, () => this.send());

  constructor(
    private readonly around: Around,
    viewport: HTMLElement,
  ) {
    for (const type of ["pointerdown", "wheel", "keydown"] as const) viewport.addEventListener(type, () => this.lookAround(), { passive: true, capture: true });
    window.addEventListener("hashchange", () => this.join());
    if (!around.store.isEmbedded) this.leadOverReloads();
  }

  private get group(): GroupState | undefined {
    return this.around.model.group();
  }

  /** What another shows is shown, or is going to be. */
  get follows(): boolean {
    return this.around.client.following;
  }

  /** Whether the camera is that of the member in control. */
  get isCameraLed(): boolean {
    return this.follows && this.group?.isApart !== true;
  }

  /** Whether the user may change what is shown; else it is said why not. */
  mayChange(): boolean {
    if (this.follows) this.around.model.toast("You are following: ask for control, or leave, to change what is shown", "brief");
    return !this.follows;
  }

  /** Follows the group that the address names. `false`: it names none. */
  join(): boolean {
    const group = groupOf(window.location.hash);
    if (group === undefined) return false;
    this.around.client.join(group, this.name, volumeOf(window.location.hash));
    return true;
  }

  act(act: GroupAct): void {
    const { client, model } = this.around;
    switch (act.type) {
      case "start":
        return client.say({ type: "lead", resume: null, codings: [] });
      case "copy":
        if (this.group !== undefined) void copyOut(model, groupLink(window.location.href, this.group.group, hasSeveralServers(this.around.store.viewer) ? client.place : undefined), "Link copied: anyone with access to this server who opens it follows");
        return;
      case "leave":
        return client.say({ type: "leave" });
      case "ask":
        return client.say({ type: "ask-control", asks: act.asks });
      case "give":
        return client.say({ type: "give-control", to: act.to });
      case "name":
        this.name = act.name.trim() === "" ? undefined : act.name.trim();
        if (this.group !== undefined) client.join(this.group.group, this.name);
        return;
      case "free":
        return this.lookAround();
      case "camera":
        this.change({ isApart: false });
        this.look();
    }
  }

  private leadOverReloads(): void {
    const { client } = this.around;
    const led = takeLeading();
    if (led !== undefined) client.leadOn(led);
    window.addEventListener("pagehide", () => keepLeading(client.leads));
    // The page was kept whole, and is shown again.
    window.addEventListener("pageshow", () => void takeLeading());
  }

  /** Whether the message is about a group. */
  receive(message: ServerMessage): boolean {
    if (message.type === "group") this.entered(message);
    else if (message.type === "led") this.led = message;
    else if (message.type === "posed") this.posed = { ...this.posed, ...message };
    else if (message.type === "left") this.left(`The group has ended: ${message.reason}`);
    else if (message.type !== "error" || (message.code !== "unknown-group" && message.code !== "group-full")) return false;
    else this.left(message.message);
    if (message.type === "led" || message.type === "posed") this.take();
    if (message.type === "posed") this.look();
    return true;
  }

  /** The connection was lost: the client joins or leads the group again on the next one, if the group still exists. */
  lost(): void {
    [this.isIn, this.sentPage, this.sentCamera] = [false, "", undefined];
  }

  /** Something is shown otherwise than before. */
  changed(): void {
    if (this.isIn && !this.follows) this.throttle.call();
  }

  /** Shows here what the leader is shown, if the leader's volume is open. */
  take(): void {
    const { store, change } = this.around;
    const { led } = this;
    const { target, volume } = store.viewer;
    if (led === undefined || !this.follows) return;
    if (target?.volume !== led.volume || target.step !== led.step) return store.dispatch({ type: "open", target: { volume: led.volume, step: led.step } });
    if (volume?.id !== led.volume || led.surfaces.length === 0) return;
    const link = this.linkOf(led.volume);
    const surfaces = led.surfaces.map(({ surface, edit }, at) => ({ number: surface, view: viewOf(edit as View), style: { ...DEFAULT_STYLE, ...link?.surfaces[at]?.style } }));
    const selected = (surfaces[link?.selected ?? 0] ?? surfaces[0])?.number ?? 0;
    const look = link === undefined ? store.look : { ...openingLookOf(store.state), ...link.look };
    change({ type: "adopt", work: { surfaces, selected, step: led.step, look }, slicing: link && (link.slicing ?? FIRST_SLICING) });
  }

  private entered(message: Extract<ServerMessage, { type: "group" }>): void {
    this.isIn = true;
    const before = this.group?.group === message.group ? this.group : undefined;
    this.around.model.say(groupNews(before, message));
    if (before === undefined) [this.sentPage, this.sentCamera] = ["", undefined];
    if (isLed(before) && !isLed(message)) [this.sentPage, this.sentCamera] = ["", undefined];
    this.around.model.group.set({ ...message, isApart: isLed(message) && before?.isApart === true });
    this.changed();
  }

  private left(why: string): void {
    const { model, alone } = this.around;
    const wasLed = groupOf(window.location.hash) !== undefined;
    this.isIn = false;
    [this.led, this.posed] = [undefined, undefined];
    model.group.set(undefined);
    model.toast(why, "lasting");
    if (wasLed) window.history.replaceState(null, "", window.location.pathname + window.location.search);
    alone();
  }

  private change(of: Partial<GroupState>): void {
    if (this.group !== undefined) this.around.model.group.set({ ...this.group, ...of });
  }

  private lookAround(): void {
    if (this.follows && this.group?.isApart === false) this.change({ isApart: true });
  }

  /** Moves the camera to the leader's pose. */
  private look(): void {
    const { framing, scene } = this.around;
    const camera = this.posed?.camera as CameraPose | undefined;
    if (camera === undefined || !this.follows || this.group?.isApart === true) return;
    // The first surface of a volume is shown from there too.
    if (framing.pose === undefined) framing.expect(false, camera);
    else scene.camera.restore(camera);
  }

  /** The leader's look, if it is one of this volume that this page can read. */
  private linkOf(volume: string): Link | undefined {
    try {
      const link = decodeLink(this.posed?.page ?? "");
      return link?.volume === volume ? link : undefined;
    } catch (error) {
      if (error instanceof LinkError) return undefined;
      throw error;
    }
  }

  private send(): void {
    const { client, framing, link, scene } = this.around;
    const state = link();
    if (state === undefined || framing.pose === undefined || this.follows || !this.isIn) return;
    const page = encodeLink({ ...state, pose: undefined });
    const camera = scene.camera.pose;
    const news = {
      ...(isEqual(camera, this.sentCamera) ? {} : { camera }),
      ...(page === this.sentPage || page.length > MAX_PAGE_CHARS ? {} : { page }),
    };
    if (Object.keys(news).length === 0) return;
    [this.sentPage, this.sentCamera] = [page, camera];
    client.say({ type: "pose", ...news });
  }
}

const viewOf = (view: View): View => ({ ...view, transferFunction: { points: sorted(view.transferFunction.points) } });
