/** What the pointer, the wheel and keys do over a slice. */

/** A place of the slice, pixels of the page from its upper left corner. */
export type Place = readonly [number, number];

export interface SliceGestures {
  /** A click, or a drag that goes on: the crosshair follows. */
  readonly onPoint: (place: Place) => void;
  /** The pointer rests over a place; `undefined`: it has left. */
  readonly onHover: (place: Place | undefined) => void;
  /** The right button drags, so many pixels since it was pressed. */
  readonly onWindow: (right: number, down: number) => void;
  /** A drag with the right button begins, or is over. */
  readonly onWindowEnd: (isOver: boolean) => void;
  readonly onReset: () => void;
  /** So many slices onward. */
  readonly onScroll: (by: number) => void;
  /** So many samples to the right and down. */
  readonly onStep: (right: number, down: number) => void;
}

/** Turning a wheel by so many pixels is one slice; touchpads send less at a time. */
const PIXELS_A_SLICE = 40;
const LINES_A_SLICE = 1;
const FAST = 10;

const ARROWS: Readonly<Record<string, Place>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const PAGES: Readonly<Record<string, number>> = { PageUp: 1, PageDown: -1 };

/** Collects turns of a wheel until they are whole slices. */
export class WheelSteps {
  private rest = 0;

  /** Upwards is onward. */
  take({ deltaY, deltaMode }: Pick<WheelEvent, "deltaY" | "deltaMode">): number {
    const turned = -deltaY / (deltaMode === 0 ? PIXELS_A_SLICE : LINES_A_SLICE);
    // What is left of a turn the other way does not delay this one.
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
    if (!isOther(event)) end();
  };
  element.addEventListener("pointerdown", (event) => {
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
    const by = wheel.take(event);
    if (by !== 0) does.onScroll(by);
  }, { passive: false });
  element.addEventListener("keydown", (event) => listenToKey(event, does));
}

function listenToKey(event: KeyboardEvent, does: SliceGestures): void {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const by = event.shiftKey ? FAST : 1;
  const [arrow, page] = [ARROWS[event.key], PAGES[event.key]];
  if (arrow === undefined && page === undefined) return;
  event.preventDefault();
  if (arrow !== undefined) does.onStep(by * arrow[0], by * arrow[1]);
  if (page !== undefined) does.onScroll(by * page);
}
