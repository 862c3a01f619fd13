/** The transfer function as a plot: importance over the blended feature, with a handle for each control point. */

import type { Histogram } from "../../protocol/types";
import { formatColor, parseColor, type Points } from "../../transfer/model";
import { h, s } from "../dom";
import { histogramPath } from "./histogram";

const WIDTH = 312;
const HEIGHT = 150;
/** Space for half a handle on every side. */
const PAD = 9;

const toX = (x: number) => PAD + x * (WIDTH - 2 * PAD);
const toY = (importance: number) => PAD + (1 - importance) * (HEIGHT - 2 * PAD);

/** Histograms behind the curve. */
export interface Background {
  readonly data: Histogram | undefined;
  /** The feature's, and the values that are 0 and 1 on the plot's axis. */
  readonly feature: { readonly histogram: Histogram; readonly range: readonly [number, number] } | undefined;
}

export class TransferPlot {
  readonly element: SVGSVGElement;
  readonly legend = h("div", { class: "legend" });
  private readonly dataCurve = s("path", { class: "curve data" });
  private readonly featureCurve = s("path", { class: "curve feature" });
  private readonly decimated = s("rect", { class: "decimated", x: PAD, width: WIDTH - 2 * PAD });
  private readonly threshold = s("line", { class: "threshold", x1: PAD, x2: WIDTH - PAD });
  private readonly thresholdKey = legendKey("beta", "decimated (≤ β)");
  private readonly area = s("path", { class: "importance-area", fill: "url(#transfer-gradient)" });
  private readonly line = s("path", { class: "importance-line" });
  private readonly gradient = s("linearGradient", {
    id: "transfer-gradient",
    gradientUnits: "userSpaceOnUse",
    x1: PAD,
    x2: WIDTH - PAD,
    y1: 0,
    y2: 0,
  });
  private readonly handles = s("g");

  constructor() {
    this.element = s(
      "svg",
      {
        class: "transfer-plot",
        viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
        role: "group",
        "aria-label": "Transfer function: importance over the blended feature. Double-click adds a point",
      },
      s("defs", {}, this.gradient),
      s("rect", { class: "frame", x: PAD, y: PAD, width: WIDTH - 2 * PAD, height: HEIGHT - 2 * PAD, rx: 2 }),
      s("g", { transform: `translate(${PAD} ${PAD})` }, this.dataCurve, this.featureCurve),
      this.area,
      this.decimated,
      this.threshold,
      this.line,
      this.handles,
    );
  }

  /** Shows the importance up to which cubes are decimated; below 0, or where β does not decide, there is no such line. */
  setThreshold(beta = -1): void {
    const shown = beta >= 0 && beta <= 1;
    this.thresholdKey.hidden = !shown;
    this.threshold.style.display = shown ? "" : "none";
    this.decimated.style.display = shown ? "" : "none";
    const y = toY(beta);
    this.threshold.setAttribute("y1", String(y));
    this.threshold.setAttribute("y2", String(y));
    this.decimated.setAttribute("y", String(y));
    this.decimated.setAttribute("height", String(Math.max(0, HEIGHT - PAD - y)));
  }

  setBackground({ data, feature }: Background, names: { readonly data: string; readonly feature: string }): void {
    const [width, height] = [WIDTH - 2 * PAD, HEIGHT - 2 * PAD];
    this.dataCurve.setAttribute("d", data === undefined ? "" : histogramPath(data, data.min, data.max, width, height));
    this.featureCurve.setAttribute(
      "d",
      feature === undefined ? "" : histogramPath(feature.histogram, ...feature.range, width, height),
    );
    this.legend.replaceChildren(
      legendKey("data", names.data),
      ...(feature === undefined ? [] : [legendKey("feature", names.feature)]),
      this.thresholdKey,
    );
  }

  render(points: Points, selected: number): void {
    const first = points[0];
    const last = points.at(-1);
    if (first === undefined || last === undefined) return;
    const path = [
      `M${toX(0)} ${toY(first.importance)}`,
      ...points.map((p) => `L${toX(p.x)} ${toY(p.importance)}`),
      `L${toX(1)} ${toY(last.importance)}`,
    ].join("");
    this.line.setAttribute("d", path);
    this.area.setAttribute("d", `${path}L${toX(1)} ${toY(0)}L${toX(0)} ${toY(0)}Z`);
    this.gradient.replaceChildren(...points.map((p) => s("stop", { offset: p.x, "stop-color": formatColor(parseColor(p.color)) })));
    this.renderHandles(points, selected);
  }

  focus(index: number): void {
    (this.handles.children[index] as SVGElement | undefined)?.focus({ preventScroll: true });
  }

  /** The control point whose handle an event hit. */
  handleAt(event: Event): number | undefined {
    const handle = event.target instanceof Element ? event.target.closest("[data-index]") : null;
    return handle === null ? undefined : Number(handle.getAttribute("data-index"));
  }

  /** Where on the plot the pointer is, rounded to a thousandth. */
  locate(event: MouseEvent): { x: number; importance: number } {
    const box = this.element.getBoundingClientRect();
    const round = (value: number) => Math.round(Math.min(1, Math.max(0, value)) * 1000) / 1000;
    return {
      x: round((((event.clientX - box.left) / box.width) * WIDTH - PAD) / (WIDTH - 2 * PAD)),
      importance: round(1 - (((event.clientY - box.top) / box.height) * HEIGHT - PAD) / (HEIGHT - 2 * PAD)),
    };
  }

  /** Handles stay the same elements, so that one that is dragged or focused stays so. */
  private renderHandles(points: Points, selected: number): void {
    const { children } = this.handles;
    while (children.length > points.length) this.handles.lastElementChild?.remove();
    while (children.length < points.length) this.handles.append(makeHandle(children.length));
    points.forEach((p, i) => {
      const handle = children[i];
      handle?.setAttribute("transform", `translate(${toX(p.x)} ${toY(p.importance)})`);
      handle?.setAttribute(
        "aria-label",
        `Point ${i + 1} of ${points.length}: x ${p.x.toFixed(2)}, importance ${p.importance.toFixed(2)}, colour ${p.color}`,
      );
      handle?.classList.toggle("selected", i === selected);
      handle?.querySelector(".dot")?.setAttribute("fill", p.color);
    });
  }
}

function makeHandle(index: number): SVGGElement {
  return s(
    "g",
    { class: "handle", "data-index": index, tabindex: 0, role: "button" },
    s("circle", { class: "grip", r: 13 }),
    s("circle", { class: "ring", r: 8.5 }),
    s("circle", { class: "dot", r: 6 }),
  );
}

function legendKey(kind: string, text: string): HTMLElement {
  return h("span", {}, h("i", { class: `key ${kind}` }), text);
}
