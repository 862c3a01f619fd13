/** A histogram with a line that can be dragged: a slider in data units. */

import type { Histogram } from "../../protocol/types";
import { s } from "../dom";
import { formatValue } from "../format";
import { histogramPath } from "./histogram";

const WIDTH = 312;
const HEIGHT = 64;

export class HistogramSlider {
  readonly element: SVGSVGElement;
  private readonly curve = s("path", { class: "histogram" });
  private readonly above = s("path", { class: "histogram above" });
  private readonly clip = s("rect", { y: 0, height: HEIGHT });
  private readonly line = s("line", { class: "needle", y1: 0, y2: HEIGHT });
  private readonly knob = s("circle", { class: "needle-knob", cy: HEIGHT - 1, r: 4.5 });
  private low = 0;
  private high = 1;
  private value = 0;

  constructor(
    label: string,
    private readonly onChange: (value: number) => void,
  ) {
    const clip = s("clipPath", { id: "above-isovalue" }, this.clip);
    this.above.setAttribute("clip-path", "url(#above-isovalue)");
    this.element = s(
      "svg",
      {
        class: "histogram-slider",
        viewBox: `0 0 ${WIDTH} ${HEIGHT + 5}`,
        role: "slider",
        tabindex: 0,
        "aria-label": label,
      },
      clip,
      this.curve,
      this.above,
      s("line", { class: "axis", x1: 0, x2: WIDTH, y1: HEIGHT, y2: HEIGHT }),
      this.line,
      this.knob,
    );
    this.element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.element.setPointerCapture(event.pointerId);
      this.pick(event);
    });
    this.element.addEventListener("pointermove", (event) => {
      if (this.element.hasPointerCapture(event.pointerId)) this.pick(event);
    });
    this.element.addEventListener("keydown", (event) => {
      const step = ((this.high - this.low) / 256) * (event.shiftKey ? 10 : 1);
      const next: Partial<Record<string, number>> = {
        ArrowLeft: this.value - step,
        ArrowDown: this.value - step,
        ArrowRight: this.value + step,
        ArrowUp: this.value + step,
        PageDown: this.value - 16 * step,
        PageUp: this.value + 16 * step,
        Home: this.low,
        End: this.high,
      };
      const value = next[event.key];
      if (value === undefined) return;
      event.preventDefault();
      this.change(value);
    });
  }

  setHistogram(histogram: Histogram): void {
    this.low = histogram.min;
    this.high = histogram.max > histogram.min ? histogram.max : histogram.min + 1;
    const path = histogramPath(histogram, this.low, this.high, WIDTH, HEIGHT);
    this.curve.setAttribute("d", path);
    this.above.setAttribute("d", path);
    this.element.setAttribute("aria-valuemin", String(this.low));
    this.element.setAttribute("aria-valuemax", String(this.high));
    this.set(this.value);
  }

  set(value: number): void {
    this.value = value;
    const t = Math.min(1, Math.max(0, (value - this.low) / (this.high - this.low)));
    const x = (t * WIDTH).toFixed(2);
    this.line.setAttribute("x1", x);
    this.line.setAttribute("x2", x);
    this.knob.setAttribute("cx", x);
    this.clip.setAttribute("x", x);
    this.clip.setAttribute("width", String(WIDTH * (1 - t)));
    this.element.setAttribute("aria-valuenow", String(value));
    this.element.setAttribute("aria-valuetext", formatValue(value));
  }

  private pick(event: PointerEvent): void {
    const box = this.element.getBoundingClientRect();
    this.change(this.low + ((this.high - this.low) * (event.clientX - box.left)) / box.width);
  }

  private change(value: number): void {
    const bounded = Math.min(this.high, Math.max(this.low, value));
    // Four digits of the range are finer than the slider: values stay readable.
    const unit = 10 ** (Math.floor(Math.log10(this.high - this.low)) - 4);
    const rounded = unit >= 1 ? Math.round(bounded / unit) * unit : Number((Math.round(bounded / unit) * unit).toPrecision(12));
    if (rounded === this.value) return;
    this.set(rounded);
    this.onChange(rounded);
  }
}
