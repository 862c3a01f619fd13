/**
 * Editor of the transfer function: control points over the blended feature, each with an importance and a colour. Drag a point;
 * double-click adds one; Delete removes one; arrows move the one in focus. Each gesture is one step of the page's history.
 */

import { createEffect, createSignal, on, Show, type JSX } from "solid-js";
import { MAX_POINTS } from "../../protocol/generated";
import { addPoint, evaluate, movePoint, recolorPoint, removePoint, type Points } from "../../transfer/model";
import { handleAt, locate, TransferPlot, type Background, type Mark } from "../plots/transferPlot";
import { Button } from "../widgets/button";
import { NumberField } from "../widgets/numberField";

export interface TransferEditorProps {
  readonly points: Points;
  readonly background: Background | undefined;
  readonly threshold: number | undefined;
  readonly mark: Mark | undefined;
  /** A value at which a point is wanted; another object adds another one. */
  readonly picked: { readonly x: number } | undefined;
  /** What the plot shows, below it. */
  readonly legend: JSX.Element;
  readonly onChange: (points: Points, gesture?: string) => void;
  readonly onEnd: () => void;
}

const DRAG = "point";

/** What the pointer and the keys do to the points. */
function editing(props: TransferEditorProps) {
  const [wanted, setSelected] = createSignal(0);
  const selected = () => Math.min(wanted(), props.points.length - 1);
  const point = () => props.points[selected()] ?? { x: 0, importance: 0, color: "#000000" };
  let plot: SVGSVGElement | undefined;
  const focus = (index: number) => plot?.querySelector<SVGElement>(`[data-index="${index}"]`)?.focus({ preventScroll: true });
  const add = (x: number, importance: number) => {
    if (props.points.length >= MAX_POINTS) return;
    const { points, index } = addPoint(props.points, x, importance);
    setSelected(index);
    props.onChange(points);
    focus(index);
  };
  return {
    selected,
    setSelected,
    point,
    focus,
    add,
    addBeside: () => {
      const { x } = point();
      const middle = (x + (props.points[selected() + 1]?.x ?? (x < 1 ? 1 : 0))) / 2;
      add(middle, evaluate(props.points, middle).importance);
    },
    remove: () => props.points.length > 1 && props.onChange(removePoint(props.points, selected())),
    move: (x: number, importance: number, gesture?: string) => props.onChange(movePoint(props.points, selected(), x, importance), gesture),
    recolor: (color: string) => props.onChange(recolorPoint(props.points, selected(), color), "colour"),
    setPlot: (element: SVGSVGElement) => (plot = element),
  };
}

type Editing = ReturnType<typeof editing>;

function onKey(event: KeyboardEvent, edit: Editing, openColor: () => void): void {
  const step = event.shiftKey ? 0.1 : 0.01;
  const moves: Partial<Record<string, readonly [number, number]>> = {
    ArrowLeft: [-step, 0],
    ArrowRight: [step, 0],
    ArrowDown: [0, -step],
    ArrowUp: [0, step],
  };
  const move = moves[event.key];
  const round = (value: number) => Math.round(value * 1e4) / 1e4;
  const { x, importance } = edit.point();
  if (move !== undefined) edit.move(round(x + move[0]), round(importance + move[1]), "keys");
  else if (event.key === "Delete" || event.key === "Backspace") edit.remove();
  else if (event.key === "Insert" || event.key === "+") edit.addBeside();
  else if (event.key === "Enter" || event.key === " ") openColor();
  else return;
  event.preventDefault();
  edit.focus(edit.selected());
}

export function TransferEditor(props: TransferEditorProps) {
  const edit = editing(props);
  const addPicked = (picked: TransferEditorProps["picked"]) => picked && edit.add(picked.x, evaluate(props.points, picked.x).importance);
  createEffect(on(() => props.picked, addPicked, { defer: true }));
  const [dragging, setDragging] = createSignal(false);
  let color: HTMLInputElement | undefined;
  const drop = () => {
    if (!dragging()) return;
    setDragging(false);
    props.onEnd();
  };
  return (
    <div class="transfer-editor">
      <TransferPlot
        points={props.points}
        selected={edit.selected()}
        background={props.background}
        threshold={props.threshold}
        mark={props.mark}
        ref={edit.setPlot}
        onPointerDown={(event) => {
          const index = handleAt(event);
          if (index === undefined || event.button !== 0) return;
          event.preventDefault();
          edit.setSelected(index);
          edit.focus(index);
          setDragging(true);
          event.currentTarget.setPointerCapture(event.pointerId);
        }}
        onPointerMove={(event) => {
          if (!dragging()) return;
          const { x, importance } = locate(event.currentTarget, event);
          edit.move(x, importance, DRAG);
        }}
        onDrop={drop}
        onDoubleClick={(event) => {
          if (handleAt(event) !== undefined) return color?.click();
          const { x, importance } = locate(event.currentTarget, event);
          edit.add(x, importance);
        }}
        onFocus={(index) => {
          if (index >= 0) edit.setSelected(index);
        }}
        onKey={(event) => onKey(event, edit, () => color?.click())}
      />
      {props.legend}
      <PointRow edit={edit} points={props.points} onEnd={props.onEnd} colorRef={(element) => (color = element)} />
    </div>
  );
}

/** The selected point in numbers: the alternative to each drag. */
function PointRow(props: { readonly edit: Editing; readonly points: Points; readonly onEnd: () => void; readonly colorRef: (element: HTMLInputElement) => void }) {
  const { edit } = props;
  return (
    <div class="point-row">
      <input
        ref={(element) => props.colorRef(element)}
        type="color"
        aria-label="Colour of the point"
        value={edit.point().color}
        on:input={(event) => edit.recolor(event.currentTarget.value)}
        on:change={() => props.onEnd()}
      />
      <label class="inline">
        x
        <NumberField label="Place of the point" value={edit.point().x} min={0} max={1} hundredPercent={1} step={0.01} onChange={(x) => edit.move(x, edit.point().importance)} />
      </label>
      <label class="inline">
        importance
        <NumberField label="Importance of the point" value={edit.point().importance} min={0} max={1} hundredPercent={1} step={0.01} onChange={(importance) => edit.move(edit.point().x, importance)} />
      </label>
      <span class="point-buttons">
        <Show when={props.points.length < MAX_POINTS}>
          <Button onClick={() => edit.addBeside()} quiet>
            Add
          </Button>
        </Show>
        <Button onClick={() => edit.remove()} quiet disabled={props.points.length <= 1}>
          Delete
        </Button>
      </span>
    </div>
  );
}
