/** Legend of the picture's colours: a bar beside it. */

export interface ColorBar {
  /** Equidistant colours, lowest first. */
  readonly stops: readonly string[];
  /** Texts at its ends, lowest first, and between them, equidistant. */
  readonly texts: readonly string[];
  /** Isolines, from 0 at the lowest colour to 1 at the highest; a text may be empty. */
  readonly lines?: readonly { readonly at: number; readonly text: string }[];
  /** What the values are, with their unit. */
  readonly title: string;
}

export class ColorScale {
  readonly element = document.createElement("div");
  private readonly title = document.createElement("b");
  private readonly texts = document.createElement("div");
  private readonly bar = document.createElement("i");

  constructor() {
    this.element.className = "scene-colors";
    this.element.hidden = true;
    this.element.append(this.title, this.texts, this.bar);
  }

  show(bar: ColorBar | undefined): void {
    this.element.hidden = bar === undefined;
    if (bar === undefined) return;
    this.title.textContent = bar.title;
    this.texts.replaceChildren(
      ...bar.texts.map((text) => {
        const span = document.createElement("span");
        span.textContent = text;
        return span;
      }),
    );
    this.bar.replaceChildren(
      ...(bar.lines ?? []).map(({ at, text }) => {
        const line = document.createElement("em");
        line.style.bottom = `${(100 * at).toFixed(2)}%`;
        line.textContent = text;
        return line;
      }),
    );
    this.bar.style.background = `linear-gradient(to top, ${bar.stops.join(", ")})`;
  }
}
