import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import type { ServerMessage, VolumeInfo } from "../src/protocol/types";
import { nextStep, stepCount, stepLabel, stepWords } from "../src/state/timeSteps";
import type { StateEvent } from "../src/state/reduce";
import { stepOf } from "../src/state/state";
import { Player } from "../src/wiring/player";
import { ActingStore, NOTHING_KNOWN, run } from "./acting";
import { CAPABILITIES, OPENING, statistics, VOLUMES } from "./fixture";

const BALL = VOLUMES[1]!;
const times = { label: "0 s", labels: ["0 s", "12.5 s", "25 s", "37.5 s", "50 s", "62.5 s"], unit: "s", calendar: null, start: 0, spacing: 12.5, values: null };

const message = (message: ServerMessage): StateEvent => ({ type: "message", message });
const opened = (volume: VolumeInfo): ServerMessage => ({ type: "opened", volume, step: 0, edit: OPENING, device: "", capabilities: CAPABILITIES });
const open: StateEvent = { type: "open", target: { volume: BALL.id, step: 0 } };

describe("time steps", () => {
  const known = { volume: { ...BALL, times }, volumes: undefined, stepLabel: undefined, target: undefined };

  test("are called as the server says", () => {
    expect(stepWords(known, 1)).toBe("12.5 s, 2 of 6");
    expect(stepWords({ ...known, volume: BALL }, 1)).toBe("2 of 6");
  });

  test("that are too many to be listed have a label once they are shown", () => {
    const many = { ...known, volume: { ...BALL, times: { ...times, labels: null } } };
    expect([stepLabel(many, 0), stepLabel(many, 3)]).toEqual(["0 s", undefined]);
    expect(stepLabel({ ...many, stepLabel: "37.5 s", target: { volume: BALL.id, step: 3 } }, 3)).toBe("37.5 s");
  });

  test("may have appeared since", () => {
    const summary = { id: BALL.id, title: "", dims: [2, 2, 2], steps: 9, fields: [], notice: null, jobServer: null } as const;
    expect([stepCount(known), stepCount({ ...known, volumes: [summary] })]).toEqual([6, 9]);
  });

  test("follow each other", () => {
    expect([nextStep(0, 3, false), nextStep(2, 3, false), nextStep(2, 3, true), nextStep(0, 1, true)]).toEqual([1, undefined, 0, undefined]);
  });
});

describe("another step", () => {
  const done = message({ type: "done", trace: "00000000000000ab", surface: 0, generation: 1, statistics: statistics(100) });
  const shown = run(NOTHING_KNOWN, open, message(opened(BALL)), { type: "swap", surface: 0, generation: 1, level: 0, final: true }, { type: "frame", at: 5 }, done);

  test("keeps the surface on screen, and is worked on until its own is done", () => {
    const asked = run(shown, { type: "open", target: { volume: BALL.id, step: 2 } });
    expect(asked).toMatchObject({ opening: true, volume: { id: BALL.id, step: 0 } });
    const stepped = run(asked, message({ type: "stepped", step: 2, label: "25 s" }));
    expect(stepped).toMatchObject({ opening: false, working: true, stepLabel: "25 s", shown: { generation: 1 }, statistics: { triangles: 100 } });
    const again = run(stepped, message({ type: "done", trace: "00000000000000ab", surface: 0, generation: 2, statistics: statistics(90) }));
    expect(again).toMatchObject({ working: false, statistics: { triangles: 90 } });
    expect(run(again, message({ type: "described", step: 2, volume: { ...BALL, step: 2 } })).volume?.step).toBe(2);
  });

  test("is a step of the history; all that are played are one", () => {
    const store = new ActingStore();
    store.dispatch(open);
    store.dispatch(message(opened(BALL)));
    store.goTo(2);
    for (const step of [3, 4, 5]) store.goTo(step, "play");
    store.endGesture();
    expect(store.step).toBe(5);
    store.undo();
    expect(store.step).toBe(2);
    store.undo();
    expect([store.step, store.canUndo]).toEqual([0, false]);
    store.redo();
    expect(store.step).toBe(2);
  });

  test("of a volume that was left is kept", () => {
    const store = new ActingStore();
    store.dispatch(open);
    store.dispatch(message(opened(BALL)));
    store.goTo(4);
    store.leave(undefined);
    expect(stepOf(store.state, BALL.id)).toBe(4);
  });
});

describe("the player", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  function playing(count: number) {
    const store = new ActingStore();
    store.dispatch(open);
    store.dispatch(message(opened({ ...BALL, steps: count })));
    const asked: number[] = [];
    const screen = { shown: true };
    const player = new Player(
      store,
      {
        isShown: () => screen.shown,
        go: (step) => {
          store.goTo(step, "play");
          asked.push(step);
          screen.shown = false;
        },
        change: (player) => store.changePage({ player }),
        onStop: () => store.endGesture(),
      },
      () => Date.now(),
    );
    const set = (settings: Partial<typeof store.page.player>) => {
      store.changePage({ player: { ...store.page.player, ...settings } });
      player.follow();
    };
    const arrive = () => {
      screen.shown = true;
      player.follow();
    };
    return { store, asked, player, set, arrive };
  }

  test("asks for a step when the last is on screen, and for none before", () => {
    const { asked, set, arrive, player } = playing(6);
    set({ playing: true, speed: 10 });
    vi.advanceTimersByTime(1);
    expect(asked).toEqual([1]);
    // A slow server: nothing waits in line.
    for (let i = 0; i < 20; i += 1) {
      player.follow();
      vi.advanceTimersByTime(500);
    }
    expect(asked).toEqual([1]);
    arrive();
    vi.advanceTimersByTime(1);
    expect(asked).toEqual([1, 2]);
  });

  test("is no faster than asked", () => {
    const { asked, set, arrive } = playing(6);
    set({ playing: true, speed: 2 });
    vi.advanceTimersByTime(1);
    arrive();
    vi.advanceTimersByTime(400);
    expect(asked).toEqual([1]);
    vi.advanceTimersByTime(200);
    expect(asked).toEqual([1, 2]);
  });

  test("begins anew, or stops at the end, and what it played is one step to undo", () => {
    const { store, asked, set, arrive } = playing(3);
    set({ playing: true, speed: 25, loop: true });
    for (let i = 0; i < 4; i += 1) {
      vi.advanceTimersByTime(100);
      arrive();
    }
    expect(asked).toEqual([1, 2, 0, 1]);
    set({ loop: false });
    for (let i = 0; i < 4; i += 1) {
      vi.advanceTimersByTime(100);
      arrive();
    }
    expect([asked, store.page.player.playing]).toEqual([[1, 2, 0, 1, 2], false]);
    store.undo();
    expect([store.step, store.canUndo]).toEqual([0, false]);
  });

  test("pauses at once", () => {
    const { asked, set, arrive } = playing(6);
    set({ playing: true, speed: 1 });
    vi.advanceTimersByTime(1);
    arrive();
    set({ playing: false });
    vi.advanceTimersByTime(5000);
    expect(asked).toEqual([1]);
  });
});
