/** The line between two pictures: dragged, or moved by arrow keys. */

export interface SwipeTexts {
  /** Over the picture on the left, which was kept, and over that on the right. */
  readonly kept: string;
  readonly now: string;
}

const KEY_STEP = 0.02;

export class Swipe {
  readonly element = document.createElement("button");
  private readonly kept = document.createElement("span");
  private readonly now = document.createElement("span");
  private share: number | undefined;

  constructor(onMove: () => void) {
    const { element } = this;
    element.type = "button";
    element.className = "scene-swipe";
    element.hidden = true;
    element.setAttribute("role", "slider");
    element.setAttribute("aria-label", "Border between the pictures that are compared");
    element.setAttribute("aria-valuemin", "0");
    element.setAttribute("aria-valuemax", "100");
    element.append(this.kept, this.now);
    const move = (share: number) => {
      this.place(share);
      onMove();
    };
    element.addEventListener("pointerdown", (event) => element.setPointerCapture(event.pointerId));
    element.addEventListener("pointermove", (event) => {
      if (!element.hasPointerCapture(event.pointerId)) return;
      const { left, width } = (element.parentElement ?? element).getBoundingClientRect();
      move((event.clientX - left) / width);
    });
    element.addEventListener("keydown", (event) => {
      const sign = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (sign === undefined || this.share === undefined) return;
      event.preventDefault();
      move(this.share + sign * KEY_STEP);
    });
  }

  /** Share of the width that shows the kept picture; `undefined` if nothing is compared. */
  get value(): number | undefined {
    return this.share;
  }

  show(share: number | undefined, texts?: SwipeTexts): void {
    this.element.hidden = share === undefined;
    this.kept.textContent = texts?.kept ?? "";
    this.now.textContent = texts?.now ?? "";
    this.kept.hidden = this.now.hidden = texts === undefined;
    if (share === undefined) this.share = undefined;
    else this.place(share);
  }

  private place(share: number): void {
    this.share = Math.min(1, Math.max(0, share));
    const percent = Math.round(100 * this.share);
    this.element.style.left = `${(100 * this.share).toFixed(2)}%`;
    this.element.setAttribute("aria-valuenow", String(percent));
    this.element.setAttribute("aria-valuetext", `${percent} % of the width`);
  }
}
