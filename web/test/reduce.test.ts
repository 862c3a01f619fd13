import { expect, test } from "vitest";
import type { ServerMessage } from "../src/protocol/types";
import { askedView } from "../src/state/comparing";
import { reduce, type StateEvent } from "../src/state/reduce";
import { FIRST_STATE, stepOf, surfaceOf, wantedOf, workOf, type State } from "../src/state/state";
import { CAPABILITIES, OPENING, VOLUMES } from "./fixture";

const run = (state: State, ...events: StateEvent[]) => events.reduce(reduce, state);
const opened = (volume: string, surfaces = 4): StateEvent[] => {
  const message: ServerMessage = { type: "opened", volume: VOLUMES.find(({ id }) => id === volume)!, step: 0, edit: OPENING, device: "", capabilities: { ...CAPABILITIES, surfaces } };
  return [{ type: "open", target: { volume, step: 0 }, leaving: { pose: undefined } }, { type: "message", message }];
};
const OPEN = run(FIRST_STATE, ...opened("ball"));

/** Freezes all of a state, so that whatever changes it in place throws. */
function frozen<T>(value: T): T {
  if (typeof value === "object" && value !== null && !Object.isFrozen(value)) Object.values(Object.freeze(value)).forEach(frozen);
  return value;
}

const USER_EVENTS: readonly StateEvent[] = [
  { type: "edit", edit: { iso: 3 } },
  { type: "edit", edit: { iso: 4 }, gesture: "iso" },
  { type: "look", look: { wireframe: true } },
  { type: "style", surface: 0, style: { opacity: 0.5 } },
  { type: "step", step: 2 },
  { type: "add", iso: 5 },
  { type: "select", surface: 0 },
  { type: "remove", surface: 1 },
  { type: "undo" },
  { type: "redo" },
  { type: "end-gesture" },
  { type: "page", layers: { tool: "keep-another" } },
  { type: "compare", comparing: { kind: "edit", isWaiting: false, kept: 9 } },
];

test("an event changes no state in place", () => {
  const state = USER_EVENTS.reduce((now, event) => frozen(reduce(now, event)), frozen(OPEN));
  expect(surfaceOf(OPEN)?.view).toEqual(OPENING);
  expect(workOf(state).step).toBe(2);
});

test("what an event does not change stays the same object", () => {
  const { page, remembered, server } = OPEN;
  const edited = run(OPEN, { type: "edit", edit: { iso: 3 } });
  expect([edited.server, edited.page, edited.remembered].map((part, i) => part === [server, page, remembered][i])).toEqual([true, true, true]);
  expect(workOf(edited).look).toBe(workOf(OPEN).look);
  const chunk = run(edited, { type: "chunk", bytes: 1 });
  expect([chunk.history, chunk.page]).toEqual([edited.history, edited.page]);
  expect(workOf(chunk)).toBe(workOf(edited));
  expect(run(edited, { type: "step", step: 0 }, { type: "end-gesture" }, { type: "select", surface: 3 })).toBe(edited);
});

test("before a volume is open, an event of the user changes the page alone", () => {
  for (const event of USER_EVENTS) {
    const { page, comparing, ...rest } = run(FIRST_STATE, event);
    expect({ ...FIRST_STATE, page, comparing }, event.type).toEqual({ ...rest, page, comparing });
  }
});

test("the server is asked for the selected surface first, as it is compared", () => {
  const two = run(OPEN, { type: "add", iso: 5 });
  expect(wantedOf(two)).toMatchObject({ target: { volume: "ball", step: 0 }, surfaces: [{ number: 1, view: { iso: 5 } }, { number: 0 }] });
  const full = { kind: "full", isWaiting: true, kept: 0 } as const;
  expect(wantedOf(run(two, { type: "compare", comparing: full })).surfaces.map(({ view }) => view.triangles)).toEqual([{ share: 1 }, { share: 1 }]);
  // What the user sees of the values is what is in force.
  expect(surfaceOf(run(two, { type: "compare", comparing: full }))?.view.triangles).toEqual(OPENING.triangles);
  expect(askedView(OPENING, { ...full, isWaiting: false })).toBe(OPENING);
});

test("what is known of a surface goes with it, and of as many as the server allows", () => {
  const two = run(OPEN, { type: "add", iso: 5 });
  expect([...two.server.known.keys()]).toEqual([0, 1]);
  expect([...run(two, { type: "remove", surface: 0 }).server.known.keys()]).toEqual([1]);
  expect([...run(two, ...opened("ball", 1)).server.known.keys()]).toEqual([0]);
});

test("work is kept of a volume that this page has left, not of one that another member has", () => {
  const edited = run(OPEN, { type: "edit", edit: { iso: 3 } }, { type: "step", step: 4 });
  const left = run(edited, ...opened("ball-mirrored"));
  expect([stepOf(left, "ball"), surfaceOf(run(left, ...opened("ball")))?.view.iso]).toEqual([4, 3]);
  const [, message] = opened("ball-mirrored");
  const led = run(edited, { type: "open", target: { volume: "ball-mirrored", step: 0 } }, message!);
  expect(led.remembered.size).toBe(0);
});

test("a link's values wait for their volume", () => {
  const wish = { volume: "ball", surfaces: [{ edit: { iso: 9 }, style: {} }], selected: 0, look: {}, pose: undefined };
  const [, ball] = opened("ball");
  const asked = run(FIRST_STATE, { type: "open", target: { volume: "ball", step: 0 }, wish });
  expect(surfaceOf(run(asked, ball!))?.view.iso).toBe(9);
  // Another volume was opened meanwhile.
  const other = run(asked, ...opened("ball-mirrored"));
  expect([surfaceOf(other)?.view.iso, other.wish]).toEqual([0, undefined]);
});
