/**
 * The editor of the paper's figure 1: control points over the blended feature, each with an importance and a colour.
 * Drag a point; double-click adds one; Delete removes one; arrows move the one in focus; every gesture can be undone.
 */

import { MAX_POINTS, type Histogram } from "../protocol/types";
import { History } from "../transfer/history";
import { addPoint, IDENTITY, movePoint, recolorPoint, removePoint, evaluate, formatColor, type Points } from "../transfer/model";
import { NumberField, button } from "./controls";
import { h, s } from "./dom";
import { histogramPath } from "./histogram";

const WIDTH = 312;
const HEIGHT = 150;
/** Room for half a point on every side. */
const PAD = 9;

const toX = (x: number) => PAD + x * (WIDTH - 2 * PAD);
const toY = (importance: number) => PAD + (1 - importance) * (HEIGHT - 2 * PAD);

export interface Background {
  readonly data: Histogram | undefined;
  /** The feature's, and the values that are 0 and 1 on the editor's axis. */
  readonly feature: { readonly histogram: Histogram; readonly range: readonly [number, number] } | undefined;
}

export class TransferEditor {
  readonly element: HTMLElement;
  private readonly history = new History<Points>(IDENTITY);
  private selected = 0;
  private dragging = false;

  private readonly plot: SVGSVGElement;
  private readonly dataCurve = s("path", { class: "curve data" });
  private readonly featureCurve = s("path", { class: "curve feature" });
  private readonly decimated = s("rect", { class: "decimated", x: PAD, width: WIDTH - 2 * PAD });
  private readonly threshold = s("line", { class: "threshold", x1: PAD, x2: WIDTH - PAD });
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
  private readonly color = h("input", { type: "color", "aria-label": "Colour of the point", title: "Colour of the selected point" });
  private readonly xField: NumberField;
  private readonly importanceField: NumberField;
  private readonly removeButton: HTMLButtonElement;
  private readonly undoButton: HTMLButtonElement;
  private readonly redoButton: HTMLButtonElement;
  private readonly legend = h("div", { class: "legend" });

  /** `onChange` hears of every new list, while it is dragged too. */
  constructor(private readonly onChange: (points: Points) => void) {
    this.plot = s(
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
    this.xField = new NumberField("x of the point", {
      min: 0,
      max: 1,
      step: () => 0.01,
      onChange: (x) => this.step(movePoint(this.points, this.selected, x, this.point.importance)),
    });
    this.importanceField = new NumberField("Importance of the point", {
      min: 0,
      max: 1,
      step: () => 0.01,
      onChange: (importance) => this.step(movePoint(this.points, this.selected, this.point.x, importance)),
    });
    this.removeButton = button("Delete", "Delete the selected point (Delete key)", () => this.remove());
    this.undoButton = button("↶", "Undo (Ctrl+Z)", () => this.undo(), "button icon");
    this.redoButton = button("↷", "Redo (Ctrl+Shift+Z)", () => this.redo(), "button icon");
    this.undoButton.setAttribute("aria-label", "Undo");
    this.redoButton.setAttribute("aria-label", "Redo");
    this.element = h(
      "div",
      { class: "transfer-editor" },
      h(
        "div",
        { class: "control-head" },
        h("span", { class: "label" }, "Transfer function"),
        h("span", { class: "note" }),
        this.undoButton,
        this.redoButton,
      ),
      this.plot,
      h("div", { class: "axis-labels" }, h("span", {}, "smooth · low feature"), h("span", {}, "rough · high feature")),
      h(
        "div",
        { class: "point-row" },
        this.color,
        h("label", { class: "inline" }, "x", this.xField.element),
        h("label", { class: "inline" }, "importance", this.importanceField.element),
        h("span", { class: "spring" }),
        this.removeButton,
      ),
      this.legend,
    );
    this.listen();
    this.render();
  }

  get points(): Points {
    return this.history.current;
  }

  /** Points from elsewhere: another volume, a server's own. The history starts over. */
  replace(points: Points): void {
    this.history.replace(points);
    this.selected = Math.min(this.selected, points.length - 1);
    this.render();
  }

  /** Cubes of importance up to this are decimated; below 0 there is no such line. */
  setThreshold(beta: number): void {
    const shown = beta >= 0 && beta <= 1;
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
    const key = (kind: string, text: string) => h("span", {}, h("i", { class: `key ${kind}` }), text);
    this.legend.replaceChildren(
      key("data", names.data),
      ...(feature === undefined ? [] : [key("feature", names.feature)]),
      key("beta", "decimated (≤ β)"),
    );
  }

  undo(): void {
    if (this.history.undo()) this.changed();
  }

  redo(): void {
    if (this.history.redo()) this.changed();
  }

  private get point(): Points[number] {
    return this.points[this.selected] ?? { x: 0, importance: 0, color: "#000000" };
  }

  private listen(): void {
    this.plot.addEventListener("pointerdown", (event) => {
      const index = this.handleAt(event);
      if (index === undefined || event.button !== 0) return;
      event.preventDefault();
      this.select(index);
      this.dragging = true;
      this.plot.setPointerCapture(event.pointerId);
    });
    this.plot.addEventListener("pointermove", (event) => {
      if (!this.dragging) return;
      const { x, importance } = this.locate(event);
      this.history.drag(movePoint(this.points, this.selected, x, importance));
      this.changed();
    });
    const drop = () => {
      if (!this.dragging) return;
      this.dragging = false;
      this.history.end();
      this.render();
    };
    this.plot.addEventListener("pointerup", drop);
    this.plot.addEventListener("pointercancel", drop);
    this.plot.addEventListener("dblclick", (event) => {
      if (this.handleAt(event) !== undefined) return this.color.click();
      const { x, importance } = this.locate(event);
      this.add(x, importance);
    });
    this.plot.addEventListener("keydown", (event) => this.key(event));
    this.plot.addEventListener("focusin", (event) => {
      const index = this.handleAt(event);
      if (index !== undefined && index !== this.selected) this.select(index);
    });
    this.color.addEventListener("input", () => {
      this.history.drag(recolorPoint(this.points, this.selected, this.color.value));
      this.changed();
    });
    this.color.addEventListener("change", () => {
      this.history.end();
      this.render();
    });
    this.element.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.target instanceof HTMLInputElement) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      if (key === "y" || event.shiftKey) this.redo();
      else this.undo();
    });
  }

  private key(event: KeyboardEvent): void {
    const step = event.shiftKey ? 0.1 : 0.01;
    const moves: Partial<Record<string, readonly [number, number]>> = {
      ArrowLeft: [-step, 0],
      ArrowRight: [step, 0],
      ArrowDown: [0, -step],
      ArrowUp: [0, step],
    };
    const move = moves[event.key];
    const { x, importance } = this.point;
    if (move !== undefined) {
      const round = (value: number) => Math.round(value * 1e4) / 1e4;
      this.step(movePoint(this.points, this.selected, round(x + move[0]), round(importance + move[1])));
    } else if (event.key === "Delete" || event.key === "Backspace") {
      this.remove();
    } else if (event.key === "Insert" || event.key === "+") {
      const next = this.points[this.selected + 1]?.x ?? 1;
      const middle = (x + next) / 2;
      this.add(middle, evaluate(this.points, middle).importance);
    } else if (event.key === "Enter" || event.key === " ") {
      this.color.click();
    } else {
      return;
    }
    event.preventDefault();
    this.focusSelected();
  }

  private add(x: number, importance: number): void {
    if (this.points.length >= MAX_POINTS) return;
    const { points, index } = addPoint(this.points, x, importance);
    this.selected = index;
    this.step(points);
    this.focusSelected();
  }

  private remove(): void {
    if (this.points.length <= 1) return;
    const points = removePoint(this.points, this.selected);
    this.selected = Math.min(this.selected, points.length - 1);
    this.step(points);
  }

  private step(points: Points): void {
    this.history.set(points);
    this.changed();
  }

  private changed(): void {
    this.selected = Math.min(this.selected, this.points.length - 1);
    this.render();
    this.onChange(this.points);
  }

  private select(index: number): void {
    this.history.end();
    this.selected = index;
    this.render();
    this.focusSelected();
  }

  private focusSelected(): void {
    (this.handles.children[this.selected] as SVGElement | undefined)?.focus({ preventScroll: true });
  }

  private handleAt(event: Event): number | undefined {
    const handle = event.target instanceof Element ? event.target.closest("[data-index]") : null;
    return handle === null ? undefined : Number(handle.getAttribute("data-index"));
  }

  private locate(event: MouseEvent): { x: number; importance: number } {
    const box = this.plot.getBoundingClientRect();
    const round = (value: number) => Math.round(Math.min(1, Math.max(0, value)) * 1000) / 1000;
    return {
      x: round((((event.clientX - box.left) / box.width) * WIDTH - PAD) / (WIDTH - 2 * PAD)),
      importance: round(1 - (((event.clientY - box.top) / box.height) * HEIGHT - PAD) / (HEIGHT - 2 * PAD)),
    };
  }

  private render(): void {
    const { points } = this;
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
    this.gradient.replaceChildren(
      ...points.map((p) => s("stop", { offset: p.x, "stop-color": formatColor(evaluate([p], 0).color) })),
    );
    // Handles stay the same elements while one is dragged or focused.
    while (this.handles.children.length > points.length) this.handles.lastElementChild?.remove();
    while (this.handles.children.length < points.length) {
      this.handles.append(
        s(
          "g",
          { class: "handle", "data-index": this.handles.children.length, tabindex: 0, role: "button" },
          s("circle", { class: "grip", r: 13 }),
          s("circle", { class: "ring", r: 8.5 }),
          s("circle", { class: "dot", r: 6 }),
        ),
      );
    }
    points.forEach((p, i) => {
      const handle = this.handles.children[i];
      handle?.setAttribute("transform", `translate(${toX(p.x)} ${toY(p.importance)})`);
      handle?.setAttribute(
        "aria-label",
        `Point ${i + 1} of ${points.length}: x ${p.x.toFixed(2)}, importance ${p.importance.toFixed(2)}, colour ${p.color}`,
      );
      handle?.classList.toggle("selected", i === this.selected);
      handle?.querySelector(".dot")?.setAttribute("fill", p.color);
    });
    if (this.color.value !== this.point.color) this.color.value = this.point.color;
    this.xField.set(this.point.x);
    this.importanceField.set(this.point.importance);
    this.removeButton.disabled = points.length <= 1;
    this.undoButton.disabled = !this.history.canUndo;
    this.redoButton.disabled = !this.history.canRedo;
  }
}
