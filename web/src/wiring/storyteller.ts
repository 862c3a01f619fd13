/** Bookmarks of what is shown, and the story that they are: played with a moving camera, or recorded as a video or as images. Loaded when there is something to do. */

import type { SurfaceRenderer } from "../scene/renderer";
import type { Link, LinkState } from "../state/link";
import type { Pose } from "../state/look";
import type { Store } from "../state/store";
import { MAX_BOOKMARKS, StoryError, type Bookmark } from "../state/story";
import { MAX_FILE_BYTES, readStoryFile } from "../state/storyFile";
import { poseBetween, readingSeconds } from "../state/storyMoves";
import type { ImageRequest, StoryAct, StoryFormat } from "../ui/actions";
import type { Model } from "../ui/model";
import { saveFile } from "../ui/takeAlong";
import type { StoryRecorder } from "./storyFrames";

/** Of a move from one bookmark to the next. */
const MOVE_SECONDS = 2;
/** A surface that takes longer is shown as it comes. */
const WAIT_MS = 20_000;
const POLL_MS = 40;

export interface StorytellerParts {
  readonly store: Store;
  readonly model: Model;
  readonly scene: SurfaceRenderer;
  /** The state now; `undefined` while there is none to link to. */
  readonly link: () => LinkState | undefined;
  readonly follow: (link: Link) => void;
  /** Of an address, and back. */
  readonly decode: (state: string) => Link | undefined;
  readonly encode: (state: LinkState) => string;
  /** All that was asked for is on screen. */
  readonly isSettled: () => boolean;
}

/** What is done with each moment of a story. */
interface Medium {
  /** Shows the camera's way for so long. `at`: the pose at a share of it. */
  readonly pass: (seconds: number, at: ((share: number) => Pose) | undefined, text: string) => Promise<void>;
}

export class Storyteller {
  /** Ends what is played; `undefined` while nothing is. */
  private running: AbortController | undefined;

  constructor(private readonly parts: StorytellerParts) {}

  readonly act = (act: StoryAct): void => {
    if (act.type === "add") this.add();
    else if (act.type === "stop") this.running?.abort();
    else if (act.type === "open") void this.open(act.file);
    else if (act.type === "show") void this.show(act.index);
    else if (act.type === "play") void this.tell(act.from ?? 0, this.screen());
    else void this.record(act.format, act.request);
  };

  private add(): void {
    const { encode, link, model, store } = this.parts;
    const state = link();
    const { story } = store.page;
    if (state === undefined) return;
    if (story.length >= MAX_BOOKMARKS) return model.toast(`There are ${MAX_BOOKMARKS} bookmarks, and no more are taken: delete some`, "brief");
    model.actions.changePage({ story: [...story, { text: "", state: encode({ ...state, story: undefined }) }] });
  }

  /** A file in place of the bookmarks that there are. */
  private async open(file: File): Promise<void> {
    const { decode, model, store } = this.parts;
    try {
      if (file.size > MAX_FILE_BYTES) throw new StoryError(`The file has ${file.size} bytes, expected a story of ${MAX_FILE_BYTES} at most`);
      const story = readStoryFile(await file.text(), decode);
      const before = store.page.story;
      model.actions.changePage({ story });
      if (before.length > 0) model.ask(`${file.name} takes the place of ${before.length} bookmarks`, [{ text: "Undo", act: () => model.actions.changePage({ story: before }) }]);
    } catch (error) {
      model.toast(error instanceof StoryError ? `${file.name}: ${error.message}` : `${file.name} cannot be read: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  private async show(index: number): Promise<void> {
    const bookmark = this.parts.store.page.story[index];
    if (bookmark !== undefined) await this.run((signal) => this.turnTo(bookmark, this.screen(), signal, MOVE_SECONDS / 2));
  }

  /** Plays the story from a bookmark on; returns whether it was played to its end. */
  private tell(from: number, medium: Medium): Promise<boolean> {
    return this.run(async (signal) => {
      const { model, store: { page: { story } } } = this.parts;
      for (let i = from; i < story.length; i += 1) {
        const bookmark = story[i];
        if (bookmark === undefined) break;
        model.telling.set({ index: i, text: bookmark.text });
        await this.turnTo(bookmark, medium, signal, i === from ? MOVE_SECONDS / 2 : MOVE_SECONDS);
        signal.throwIfAborted();
        await medium.pass(readingSeconds(bookmark.text), undefined, bookmark.text);
        signal.throwIfAborted();
      }
    });
  }

  /** One thing at a time: what was played ends. */
  private async run(act: (signal: AbortSignal) => Promise<void>): Promise<boolean> {
    this.running?.abort();
    const running = new AbortController();
    this.running = running;
    const { model } = this.parts;
    try {
      await act(running.signal);
      return true;
    } catch (error) {
      if (!running.signal.aborted) model.toast(`The story has ended: ${error instanceof Error ? error.message : String(error)}`);
      return false;
    } finally {
      if (this.running === running) {
        this.running = undefined;
        model.telling.set(undefined);
      }
    }
  }

  /** To the state of a bookmark; the camera moves there. */
  private async turnTo({ state, text }: Bookmark, medium: Medium, signal: AbortSignal, seconds: number): Promise<void> {
    const { decode, follow, scene, store } = this.parts;
    const link = decode(state);
    if (link === undefined) return;
    const from = scene.camera.pose;
    const isSame = store.viewer.volume?.id === link.volume;
    follow(isSame ? { ...link, pose: undefined } : link);
    await this.settled(signal);
    const { pose } = link;
    if (pose === undefined || !isSame) return;
    await medium.pass(seconds, (share) => poseBetween(from, pose, share), text);
    // To the last digit.
    if (!signal.aborted) scene.camera.restore(pose);
  }

  private async settled(signal: AbortSignal): Promise<void> {
    // The edit is sent first.
    await wait(POLL_MS);
    for (const began = performance.now(); !this.parts.isSettled() && performance.now() - began < WAIT_MS; ) {
      signal.throwIfAborted();
      await wait(POLL_MS);
    }
    signal.throwIfAborted();
  }

  /** The picture on the page. A user who prefers reduced motion gets pictures one after the other. */
  private screen(): Medium {
    const { scene } = this.parts;
    return {
      pass: async (seconds, at) => {
        const { signal } = this.running ?? {};
        if (at === undefined) return wait(1000 * seconds, signal);
        if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) return scene.camera.restore(at(1));
        for (const began = performance.now(); signal?.aborted !== true; ) {
          const share = Math.min(1, (performance.now() - began) / (1000 * seconds));
          scene.camera.restore(at(share));
          if (share >= 1) return;
          await new Promise(requestAnimationFrame);
        }
      },
    };
  }

  private async record(format: StoryFormat, request: ImageRequest): Promise<void> {
    const { model } = this.parts;
    try {
      const recorder = await this.recorder(format, request);
      if (recorder === undefined) return model.toast(`This browser makes no ${format === "mp4" ? "MP4" : "video"}: choose another kind of file`);
      const isWhole = await this.tell(0, { pass: (seconds, at, text) => recorder.pass(seconds, at, text, this.running?.signal) });
      if (!isWhole) return recorder.cancel();
      const { blob, ending } = await recorder.end();
      saveFile(`story.${ending}`, blob);
      model.toast(`story.${ending} is ready`, "brief");
    } catch (error) {
      model.toast(`The story could not be saved: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  /** `undefined` if the browser cannot make such a file. */
  private async recorder(format: StoryFormat, request: ImageRequest): Promise<StoryRecorder | undefined> {
    const { scene, store } = this.parts;
    const { StoryFrames } = await import("./storyFrames");
    const frames = new StoryFrames(scene, store, request);
    if (format === "webm") return (await import("./storyWebm")).WebmRecorder.begin(frames);
    if (format === "mp4") return (await import("./storyMp4")).Mp4Recorder.begin(frames);
    return new (await import("./storyImages")).ImagesRecorder(frames);
  }
}

function wait(ms: number, signal?: AbortSignal): Promise<void> {
  return new Promise((done) => {
    const timer = setTimeout(done, ms);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      done();
    });
  });
}
