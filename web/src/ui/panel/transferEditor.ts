/**
 * The editor of the paper's figure 1: control points over the blended feature, each with an importance and a colour.
 * Drag a point; double-click adds one; Delete removes one; arrows move the one in focus; every gesture can be undone.
 */

import { MAX_POINTS } from "../../protocol/generated";
import { History } from "../../transfer/history";
import { addPoint, evaluate, IDENTITY, movePoint, recolorPoint, removePoint, type Points } from "../../transfer/model";
import { NumberField, button } from "../controls";
import { h } from "../dom";
import { TransferPlot, type Background } from "./transferPlot";

export class TransferEditor {
  readonly element: HTMLElement;
  private readonly history = new History<Points>(IDENTITY);
  private selected = 0;
  private dragging = false;
  private readonly plot = new TransferPlot();
  private readonly color = h("input", { type: "color", "aria-label": "Colour of the point", title: "Colour of the selected point" });
  private readonly xField: NumberField;
  private readonly importanceField: NumberField;
  private readonly removeButton: HTMLButtonElement;
  private readonly undoButton: HTMLButtonElement;
  private readonly redoButton: HTMLButtonElement;

  /** `onChange` receives every new list, also while a point is dragged. */
  constructor(private readonly onChange: (points: Points) => void) {
    const unit = { min: 0, max: 1, step: () => 0.01 };
    this.xField = new NumberField("x of the point", {
      ...unit,
      onChange: (x) => this.apply(movePoint(this.points, this.selected, x, this.point.importance)),
    });
    this.importanceField = new NumberField("Importance of the point", {
      ...unit,
      onChange: (importance) => this.apply(movePoint(this.points, this.selected, this.point.x, importance)),
    });
    this.removeButton = button("Delete", "Delete the selected point (Delete key)", () => this.remove());
    this.undoButton = button("↶", "Undo (Ctrl+Z)", () => this.undo(), "button icon");
    this.redoButton = button("↷", "Redo (Ctrl+Shift+Z)", () => this.redo(), "button icon");
    this.undoButton.setAttribute("aria-label", "Undo");
    this.redoButton.setAttribute("aria-label", "Redo");
    this.element = this.layOut();
    this.listenToPointer();
    this.listenToKeys();
    this.listenToColor();
    this.render();
  }

  get points(): Points {
    return this.history.current;
  }

  /** Takes up points that are not an edit of the present ones. The history starts over. */
  replace(points: Points): void {
    this.history.replace(points);
    this.selected = Math.min(this.selected, points.length - 1);
    this.render();
  }

  /** Shows the importance up to which cubes are decimated; below 0, or where β does not decide, there is no such line. */
  setThreshold(beta: number | undefined): void {
    this.plot.setThreshold(beta);
  }

  setBackground(background: Background, names: { readonly data: string; readonly feature: string }): void {
    this.plot.setBackground(background, names);
  }

  private get point(): Points[number] {
    return this.points[this.selected] ?? { x: 0, importance: 0, color: "#000000" };
  }

  private layOut(): HTMLElement {
    const head = [h("span", { class: "label" }, "Transfer function"), h("span", { class: "note" }), this.undoButton, this.redoButton];
    return h(
      "div",
      { class: "transfer-editor" },
      h("div", { class: "control-head" }, ...head),
      this.plot.element,
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
      this.plot.legend,
    );
  }

  private listenToPointer(): void {
    const { plot } = this;
    plot.element.addEventListener("pointerdown", (event) => {
      const index = plot.handleAt(event);
      if (index === undefined || event.button !== 0) return;
      event.preventDefault();
      this.select(index);
      this.dragging = true;
      plot.element.setPointerCapture(event.pointerId);
    });
    plot.element.addEventListener("pointermove", (event) => {
      if (!this.dragging) return;
      const { x, importance } = plot.locate(event);
      this.history.drag(movePoint(this.points, this.selected, x, importance));
      this.changed();
    });
    const drop = () => {
      if (!this.dragging) return;
      this.dragging = false;
      this.history.end();
      this.render();
    };
    plot.element.addEventListener("pointerup", drop);
    plot.element.addEventListener("pointercancel", drop);
    plot.element.addEventListener("dblclick", (event) => {
      if (plot.handleAt(event) !== undefined) return this.color.click();
      const { x, importance } = plot.locate(event);
      this.add(x, importance);
    });
    plot.element.addEventListener("focusin", (event) => {
      const index = plot.handleAt(event);
      if (index !== undefined && index !== this.selected) this.select(index);
    });
  }

  private listenToKeys(): void {
    this.plot.element.addEventListener("keydown", (event) => this.key(event));
    this.element.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.target instanceof HTMLInputElement) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      if (key === "y" || event.shiftKey) this.redo();
      else this.undo();
    });
  }

  private listenToColor(): void {
    this.color.addEventListener("input", () => {
      this.history.drag(recolorPoint(this.points, this.selected, this.color.value));
      this.changed();
    });
    this.color.addEventListener("change", () => {
      this.history.end();
      this.render();
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
      this.apply(movePoint(this.points, this.selected, round(x + move[0]), round(importance + move[1])));
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
    this.plot.focus(this.selected);
  }

  private undo(): void {
    if (this.history.undo()) this.changed();
  }

  private redo(): void {
    if (this.history.redo()) this.changed();
  }

  private add(x: number, importance: number): void {
    if (this.points.length >= MAX_POINTS) return;
    const { points, index } = addPoint(this.points, x, importance);
    this.selected = index;
    this.apply(points);
    this.plot.focus(this.selected);
  }

  private remove(): void {
    if (this.points.length <= 1) return;
    const points = removePoint(this.points, this.selected);
    this.selected = Math.min(this.selected, points.length - 1);
    this.apply(points);
  }

  /** A step of its own in the history. */
  private apply(points: Points): void {
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
    this.plot.focus(index);
  }

  private render(): void {
    this.plot.render(this.points, this.selected);
    if (this.color.value !== this.point.color) this.color.value = this.point.color;
    this.xField.set(this.point.x);
    this.importanceField.set(this.point.importance);
    this.removeButton.disabled = this.points.length <= 1;
    this.undoButton.disabled = !this.history.canUndo;
    this.redoButton.disabled = !this.history.canRedo;
  }
}
