/** What the pointer, the wheel and keys do over a slice. */

/** A place of the slice, pixels of the page from its upper left corner. */
export type Place = readonly [number, number];

export interface SliceGestures {
  /** A click, or a drag that goes on: the crosshair follows. */
  readonly onPoint: (place: Place) => void;
  /** The pointer rests over a place; `undefined`: it has left. */
  readonly onHover: (place: Place | undefined) => void;
  /** The right button drags; the distances are in pixels since it was pressed. */
  readonly onWindow: (right: number, down: number) => void;
  /** A drag with the right button begins, or is over. */
  readonly onWindowEnd: (isOver: boolean) => void;
  readonly onReset: () => void;
  /** Larger by a factor around a place; `undefined`: around the crosshair. */
  readonly onZoom: (place: Place | undefined, by: number) => void;
  /** Two fingers move it by a number of pixels. */
  readonly onPan: (right: number, down: number) => void;
  /** Scrolls `by` slices onward. */
  readonly onScroll: (by: number) => void;
  /** Steps by samples to the right and down. */
  readonly onStep: (right: number, down: number) => void;
}

/** Pixels of a wheel's turn that scroll one slice; touchpads send less at a time. */
const PIXELS_A_SLICE = 40;
const LINES_A_SLICE = 1;
const FAST = 10;

const ARROWS: Readonly<Record<string, Place>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const PAGES: Readonly<Record<string, number>> = { PageUp: 1, PageDown: -1 };

/** What a turn of the wheel with Control, or two fingers on a touchpad, makes larger: by a pixel, and by a line. */
const ZOOM_A_PIXEL = 0.004;
const ZOOM_A_LINE = 0.12;
const ZOOM_KEYS: Readonly<Record<string, number>> = { "+": 1.25, "=": 1.25, "-": 0.8, _: 0.8, "0": 0 };

export function wheelZoom({ deltaY, deltaMode }: Pick<WheelEvent, "deltaY" | "deltaMode">): number {
  return Math.exp(-deltaY * (deltaMode === 0 ? ZOOM_A_PIXEL : ZOOM_A_LINE));
}

/** Two fingers: how far they move apart, and their centre. */
class Pinch {
  private readonly fingers = new Map<number, Place>();

  get isUnderWay(): boolean {
    return this.fingers.size > 1;
  }

  put(pointer: number, place: Place): void {
    this.fingers.set(pointer, place);
  }

  lift(pointer: number): void {
    this.fingers.delete(pointer);
  }

  /** A finger moves; whether it is one of two. */
  move(pointer: number, place: Place, does: Pick<SliceGestures, "onPan" | "onZoom">): boolean {
    if (!this.fingers.has(pointer)) return false;
    const before = this.state();
    this.fingers.set(pointer, place);
    const after = this.state();
    if (before === undefined || after === undefined) return false;
    does.onPan(after.middle[0] - before.middle[0], after.middle[1] - before.middle[1]);
    does.onZoom(after.middle, after.apart / before.apart);
    return true;
  }

  private state(): { readonly middle: Place; readonly apart: number } | undefined {
    const [a, b] = [...this.fingers.values()];
    return a && b && { middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2], apart: Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1])) };
  }
}

/** Collects turns of a wheel until they are whole slices. */
export class WheelSteps {
  private rest = 0;

  /** Upwards is onward. */
  take({ deltaY, deltaMode }: Pick<WheelEvent, "deltaY" | "deltaMode">): number {
    const turned = -deltaY / (deltaMode === 0 ? PIXELS_A_SLICE : LINES_A_SLICE);
    // The remainder of a turn in the other direction does not delay this one.
    this.rest = (turned * this.rest < 0 ? 0 : this.rest) + turned;
    // A notch of a mouse is one, however many pixels a browser takes it for.
    const steps = Math.abs(turned) >= 1 ? Math.sign(turned) * Math.max(1, Math.round(Math.abs(turned) / 3)) : Math.trunc(this.rest);
    if (steps !== 0) this.rest = 0;
    return steps;
  }
}

export function listenToSlice(element: HTMLElement, does: SliceGestures): void {
  let drag: { readonly pointer: number; readonly button: number; readonly from: Place } | undefined;
  const wheel = new WheelSteps();
  const pinch = new Pinch();
  const placeOf = ({ clientX, clientY }: MouseEvent): Place => {
    const { left, top } = element.getBoundingClientRect();
    return [clientX - left, clientY - top];
  };
  const isOther = ({ pointerId }: PointerEvent) => drag !== undefined && drag.pointer !== pointerId;
  const end = () => {
    if (drag?.button === 2) does.onWindowEnd(true);
    drag = undefined;
  };
  const endOf = (event: PointerEvent) => {
    pinch.lift(event.pointerId);
    if (!isOther(event)) end();
  };
  element.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "touch") pinch.put(event.pointerId, placeOf(event));
    if (pinch.isUnderWay) return end();
    if (!event.isPrimary || (event.button !== 0 && event.button !== 2)) return;
    // The end of the drag before may have been missed.
    end();
    // On a Mac the right button is Control and the left one.
    const button = event.ctrlKey ? 2 : event.button;
    drag = { pointer: event.pointerId, button, from: placeOf(event) };
    element.setPointerCapture(event.pointerId);
    if (button === 0) does.onPoint(drag.from);
    else does.onWindowEnd(false);
  });
  element.addEventListener("pointermove", (event) => {
    if (pinch.move(event.pointerId, placeOf(event), does)) return;
    if (isOther(event)) return;
    const place = placeOf(event);
    if (drag === undefined && event.pointerType !== "touch") does.onHover(place);
    if (drag?.button === 0) does.onPoint(place);
    if (drag?.button === 2) does.onWindow(place[0] - drag.from[0], place[1] - drag.from[1]);
  });
  element.addEventListener("pointerup", endOf);
  element.addEventListener("pointercancel", endOf);
  element.addEventListener("pointerleave", () => does.onHover(undefined));
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", () => does.onReset());
  element.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (event.ctrlKey) return does.onZoom(placeOf(event), wheelZoom(event));
    const by = wheel.take(event);
    if (by !== 0) does.onScroll(by);
  }, { passive: false });
  element.addEventListener("keydown", (event) => listenToKey(event, does));
}

function listenToKey(event: KeyboardEvent, does: SliceGestures): void {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const zoom = ZOOM_KEYS[event.key];
  if (zoom !== undefined) {
    event.preventDefault();
    return does.onZoom(undefined, zoom);
  }
  const by = event.shiftKey ? FAST : 1;
  const [arrow, page] = [ARROWS[event.key], PAGES[event.key]];
  if (arrow === undefined && page === undefined) return;
  event.preventDefault();
  if (arrow !== undefined) does.onStep(by * arrow[0], by * arrow[1]);
  if (page !== undefined) does.onScroll(by * page);
}
