import { expect, test } from "vitest";
import { listenToSlice, wheelZoom, type SliceGestures } from "../src/ui/slicePanel/gestures";

/** A slice whose corner is that of the page, and what was done over it. */
function slice() {
  const done: unknown[] = [];
  const note = (name: string) => (...of: unknown[]) => void done.push([name, ...of]);
  const gestures: SliceGestures = { onPoint: note("point"), onHover: note("hover"), onWindow: note("window"), onWindowEnd: note("end"), onReset: note("reset"), onScroll: note("scroll"), onStep: note("step"), onZoom: note("zoom"), onPan: note("pan") };
  const element = Object.assign(new EventTarget(), { getBoundingClientRect: () => ({ left: 0, top: 0 }), setPointerCapture: () => undefined });
  listenToSlice(element as unknown as HTMLElement, gestures);
  const send = (type: string, pointerId: number, x: number, button = 0, more: object = {}) => {
    element.dispatchEvent(Object.assign(new Event(type), { pointerId, isPrimary: true, pointerType: "mouse", button, ctrlKey: false, clientX: x, clientY: 0, ...more }));
    return done.splice(0);
  };
  return send;
}

test("a drag is that of the pointer that began it", () => {
  const send = slice();
  expect(send("pointerdown", 1, 5)).toEqual([["point", [5, 0]]]);
  expect([send("pointermove", 2, 90), send("pointerup", 2, 90), send("pointercancel", 2, 90)]).toEqual([[], [], []]);
  expect(send("pointermove", 1, 6)).toEqual([["point", [6, 0]]]);
  send("pointerup", 1, 6);
  expect(send("pointermove", 1, 7)).toEqual([["hover", [7, 0]]]);
  expect(send("pointerdown", 2, 10, 2)).toEqual([["end", false]]);
  expect([send("pointerup", 1, 0), send("pointermove", 2, 14), send("pointerup", 2, 14)]).toEqual([[], [["window", 4, 0]], [["end", true]]]);
  // Another pointer goes on instead, if the end of a drag was missed.
  send("pointerdown", 2, 10, 2);
  expect([send("pointerdown", 3, 20), send("pointermove", 2, 30), send("pointermove", 3, 21)]).toEqual([[["end", true], ["point", [20, 0]]], [], [["point", [21, 0]]]]);
});

test("two fingers zoom and move, and end the drag of the first", () => {
  const send = slice();
  const touch = { pointerType: "touch" };
  expect(send("pointerdown", 1, 10, 0, touch)).toEqual([["point", [10, 0]]]);
  expect(send("pointerdown", 2, 30, 0, { ...touch, isPrimary: false })).toEqual([]);
  expect(send("pointermove", 2, 50, 0, touch)).toEqual([["pan", 10, 0], ["zoom", [30, 0], 2]]);
  send("pointerup", 2, 50, 0, touch);
  expect(send("pointermove", 1, 12, 0, touch)).toEqual([]);
  send("pointerup", 1, 12, 0, touch);
  expect(send("pointerdown", 3, 5, 0, touch)).toEqual([["point", [5, 0]]]);
});

test("Control with the wheel zooms, the wheel alone goes through slices; keys zoom around the crosshair", () => {
  const send = slice();
  const wheel = { deltaY: -100, deltaMode: 0 };
  expect(send("wheel", 1, 7, 0, { ...wheel, ctrlKey: true })).toEqual([["zoom", [7, 0], wheelZoom(wheel)]]);
  expect(wheelZoom(wheel)).toBeCloseTo(1 / wheelZoom({ deltaY: 100, deltaMode: 0 }));
  expect(send("wheel", 1, 7, 0, wheel)[0]).toEqual(["scroll", 1]);
  const key = (name: string) => send("keydown", 1, 0, 0, { key: name, altKey: false, metaKey: false });
  expect([key("+"), key("-"), key("0")]).toEqual([[["zoom", undefined, 1.25]], [["zoom", undefined, 0.8]], [["zoom", undefined, 0]]]);
});
