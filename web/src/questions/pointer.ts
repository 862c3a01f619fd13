/** The pointer over the picture: its resting place, and clicks. Drags are left to the camera. */

import type { Place } from "./prober";

export interface PointerHandlers {
  readonly onHover: (place: Place) => void;
  readonly onLeave: () => void;
  /** A click, or Enter: then at the centre of the picture. */
  readonly onClick: (place: Place) => void;
  readonly onEscape: () => void;
}

/** A pointer that moves by more between down and up drags; pixels. */
const CLICK_WITHIN = 5;

/** The centre of an element. */
export function centreOf(element: Element): Place {
  const { left, top, width, height } = element.getBoundingClientRect();
  return [left + width / 2, top + height / 2];
}

/** Listens to the picture's canvas, not to elements over it. */
export function listenToPicture(viewport: HTMLElement, handlers: PointerHandlers): void {
  let down: Place | undefined;
  const isPicture = (event: Event) => event.target instanceof HTMLCanvasElement;
  viewport.addEventListener("pointerdown", (event) => {
    down = isPicture(event) && event.button === 0 && event.isPrimary ? [event.clientX, event.clientY] : undefined;
    handlers.onLeave();
  });
  viewport.addEventListener("pointermove", (event) => {
    // A finger does not rest over the picture, it turns it.
    if (event.buttons === 0 && event.pointerType !== "touch" && isPicture(event)) handlers.onHover([event.clientX, event.clientY]);
  });
  viewport.addEventListener("pointerup", (event) => {
    const [x, y] = down ?? [Infinity, Infinity];
    down = undefined;
    if (Math.hypot(event.clientX - x, event.clientY - y) <= CLICK_WITHIN) handlers.onClick([event.clientX, event.clientY]);
  });
  viewport.addEventListener("pointerleave", () => handlers.onLeave());
  viewport.addEventListener("wheel", () => handlers.onLeave(), { passive: true });
  viewport.addEventListener("keydown", (event) => {
    if (!isPicture(event)) return;
    if (event.key === "Enter") handlers.onClick(centreOf(viewport));
    if (event.key === "Escape") handlers.onEscape();
  });
}
