/** Serves the requests of the embedding page. */

import { isEqual } from "../protocol/equal";
import { HostPort, type HostEvent, type PageState } from "../embed/hostPort";
import type { EmbedOptions } from "../embed/origins";
import { RequestError, type HostRequest } from "../embed/requests";
import type { SurfaceRenderer } from "../scene/renderer";
import { allTriangles } from "../state/counts";
import { changedLink, decodeLink, encodeLink, type Link, type LinkState } from "../state/link";
import type { Store } from "../state/store";
import type { Model } from "../ui/model";
import type { Cameras } from "./cameras";
import { EmbedToken } from "./embedToken";
import type { Framing } from "./framing";

interface EmbeddingParts {
  readonly store: Store;
  readonly model: Model;
  readonly scene: SurfaceRenderer;
  readonly framing: Framing;
  readonly cameras: Cameras;
  /** The state now; `undefined` while there is none to link to. */
  readonly link: () => LinkState | undefined;
  /** The final surface is on screen. */
  readonly isSettled: () => boolean;
  readonly follow: (link: Link) => void;
  /** Of the server. */
  readonly base: URL;
  /** Connects with what the server is shown now. */
  readonly reconnect: () => void;
}

/** The origin of the embedding page, if the browser tells it. */
function originAround(): string | undefined {
  // Not known to all browsers.
  const { ancestorOrigins } = window.location as { readonly ancestorOrigins?: DOMStringList };
  const around = ancestorOrigins?.[0] ?? document.referrer;
  return URL.canParse(around) ? new URL(around).origin : undefined;
}

export class Embedding {
  private readonly port: HostPort;
  private readonly token: EmbedToken;
  private isReady = false;
  /** What the embedding page was last told to be on screen. */
  private settled: unknown;

  constructor(
    { origins, problems }: EmbedOptions,
    private readonly parts: EmbeddingParts,
  ) {
    const { model, scene } = parts;
    this.port = new HostPort(window, origins, originAround(), (request, origin) => this.answer(request, origin));
    this.token = new EmbedToken(this.port, parts.base, parts.reconnect);
    scene.annotations.show({ handles: false });
    model.onError = (message) => this.port.emit({ type: "error", message });
    for (const problem of problems) model.toast(problem);
  }

  /**
   * The server asks for a token: requests one from the embedding page, if there is one.
   *
   * @returns what to tell the user then
   */
  refused(): string | undefined {
    if (!this.port.isFramed) return undefined;
    this.token.ask();
    return "the server asks for a token, which the page around this picture has to hand over";
  }

  /** Sends the events that are due to the embedding page. */
  follow(isSettled: boolean): void {
    const { store } = this.parts;
    const { volumes, target } = store.viewer;
    if (!this.isReady && volumes !== undefined) {
      this.isReady = true;
      this.port.emit({ type: "ready", volumes: volumes.map(({ id, title }) => ({ id, title })) });
    }
    if (!isSettled) return;
    const surfaces = [...store.viewer.known].map(([number, { edited, shown, statistics }]) => [number, shown && edited, statistics?.isTreeCut]);
    const now = [target, surfaces];
    if (isEqual(now, this.settled)) return;
    this.settled = now;
    this.port.emit({ type: "settled", ...this.state(true) } satisfies HostEvent);
  }

  private state(settled: boolean): PageState {
    const { scene, store, link } = this.parts;
    const state = link();
    const all = [...store.viewer.known.values()];
    const known = all.flatMap(({ statistics }) => (statistics === undefined ? [] : allTriangles(statistics)));
    return {
      link: state === undefined ? null : encodeLink(state),
      settled,
      triangles: scene.levelTriangles.reduce((sum, n) => sum + n, 0),
      fullTriangles: known.length === all.length ? known.reduce((sum, n) => sum + n, 0) : null,
    };
  }

  private answer(request: HostRequest, origin: string): unknown {
    if (request.type === "token") return this.token.take(request.token, origin);
    if (!this.isReady) throw new RequestError("isopeel does not know the volumes yet: wait for the event “ready”");
    switch (request.type) {
      case "get":
        return this.state(this.parts.isSettled());
      case "set":
        return this.show(request.link);
      case "change": {
        const state = this.parts.link();
        if (state === undefined) throw new RequestError("no volume is open that could be changed: use “set” with a link that names one");
        return this.show(changedLink(state, request.values));
      }
      case "camera":
        return this.moveCamera(request.to);
      case "image":
        return this.takeImage(request.image);
    }
  }

  /** @throws LinkError or RequestError naming what was wrong */
  private show(text: string): object {
    const link = decodeLink(text);
    if (link === undefined) throw new RequestError("link names no volume, expected text such as volume=head&iso=300");
    const { volumes = [] } = this.parts.store.viewer;
    if (!volumes.some(({ id }) => id === link.volume)) {
      throw new RequestError(`there is no volume ${JSON.stringify(link.volume)}. There are: ${volumes.map(({ id }) => id).join(", ")}`);
    }
    this.parts.follow(link);
    return {};
  }

  private moveCamera(to: Extract<HostRequest, { type: "camera" }>["to"]): object {
    const { framing, scene } = this.parts;
    if (scene.regionCount === 0) throw new RequestError("there is no surface to look at yet: wait for the event “settled”");
    if (to === "home") framing.home();
    else if (to === "fit") framing.fit();
    else if (typeof to === "string") framing.lookFrom(to);
    else if (to !== undefined) scene.camera.restore(to, true);
    const { position, target } = scene.camera.pose;
    return { position, target };
  }

  private async takeImage(request: Extract<HostRequest, { type: "image" }>["image"]): Promise<Blob> {
    const { scene, store } = this.parts;
    if (scene.regionCount === 0) throw new RequestError("there is no surface to take a picture of yet: wait for the event “settled”");
    const { makeImage } = await import("./imageMaker");
    return this.parts.cameras.image(request.scale, async (pose) => (await makeImage(scene, store, { ...request, slices: false }, pose)).blob);
  }
}
