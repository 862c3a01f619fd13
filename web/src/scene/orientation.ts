/** Orientation aids: a cube of axes that sets views, and a bar of a round length. */

import { Vector3, type Camera } from "three";
import { sidesOf, type AxisName } from "../world/axes";
import { upAlong } from "./pose";
import { roundBelow, scaleBar, tickText } from "../world/ticks";

const SVG = "http://www.w3.org/2000/svg";
/** Half the cube's edge, in units of a view box of 100. */
const HALF = 27;
/** In views that are level. */
const UPRIGHT = new Vector3(0, 0, 1);

interface Face {
  readonly axis: AxisName;
  readonly normal: Vector3;
  /** Upwards in the view of this axis. */
  up: Vector3;
}

const FACES = (
  [
    ["+x", [1, 0, 0]],
    ["-x", [-1, 0, 0]],
    ["+y", [0, 1, 0]],
    ["-y", [0, -1, 0]],
    ["+z", [0, 0, 1]],
    ["-z", [0, 0, -1]],
  ] as const
).map(([axis, normal]) => ({ axis, normal: new Vector3(...normal) }));

/** A cube in the corner that turns with the picture; its faces are buttons. */
export class AxesCube {
  readonly element = document.createElementNS(SVG, "svg");
  private readonly faces: readonly { readonly face: Face; readonly group: SVGGElement; readonly outline: SVGPolygonElement; readonly text: SVGTextElement }[];
  private turned = "";

  constructor(onView: (axis: AxisName) => void) {
    this.element.setAttribute("class", "scene-axes");
    this.element.setAttribute("viewBox", "-50 -50 100 100");
    this.element.setAttribute("role", "group");
    this.element.setAttribute("aria-label", "Views along the axes");
    this.faces = FACES.map(({ axis, normal }) => {
      const face: Face = { axis, normal, up: UPRIGHT };
      const group = document.createElementNS(SVG, "g");
      group.setAttribute("role", "button");
      group.setAttribute("tabindex", "0");
      const outline = document.createElementNS(SVG, "polygon");
      const text = document.createElementNS(SVG, "text");
      group.append(outline, text);
      group.addEventListener("click", () => onView(face.axis));
      group.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        onView(face.axis);
      });
      this.element.append(group);
      return { face, group, outline, text };
    });
    this.frame = undefined;
  }

  /** In a frame of a patient, the faces show the patient's sides; otherwise the axes' names. */
  set frame(frame: string | undefined) {
    const sides = sidesOf(frame);
    this.turned = "";
    for (const { face, group, text } of this.faces) {
      if (face.axis === "+z" || face.axis === "-z") face.up = new Vector3(...upAlong(face.axis, frame));
      const side = sides[face.axis];
      const axis = face.axis.toUpperCase().replace("-", "−");
      text.textContent = side?.letter ?? axis;
      group.setAttribute("aria-label", `View from ${side === undefined ? axis : `${side.word}, ${axis}`}`);
    }
  }

  update(camera: Camera): void {
    const turned = camera.quaternion.toArray().map((c) => c.toFixed(4)).join();
    if (turned === this.turned) return;
    this.turned = turned;
    const toView = camera.quaternion.clone().invert();
    for (const { face, group, outline, text } of this.faces) {
      const n = face.normal.clone().applyQuaternion(toView);
      // Not focusable while it is not visible.
      group.style.display = n.z > 0.02 ? "" : "none";
      if (n.z <= 0.02) continue;
      const v = face.up.clone().applyQuaternion(toView);
      const u = face.up.clone().cross(face.normal).applyQuaternion(toView);
      const corner = (right: number, top: number) => `${(HALF * (n.x + right * u.x + top * v.x)).toFixed(2)},${(-HALF * (n.y + right * u.y + top * v.y)).toFixed(2)}`;
      outline.setAttribute("points", [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)].join(" "));
      const matrix = [u.x, -u.y, -v.x, v.y, HALF * n.x, -HALF * n.y].map((c) => c.toFixed(3));
      text.setAttribute("transform", `matrix(${matrix.join(" ")})`);
    }
  }
}

/** Width that the bar takes at most, pixels. */
const WIDEST = 140;

/** A bar of a round length in the world, at the distance of the camera's target. */
export class ScaleBar {
  readonly element = document.createElement("div");
  private readonly text = document.createElement("span");
  private readonly bar = document.createElement("i");
  private units = "";
  private heights = "";

  constructor() {
    this.element.className = "scene-scale";
    this.element.append(this.text, this.bar);
  }

  /** The world's unit, such as `mm`; may be empty. */
  set unit(unit: string) {
    this.units = unit;
  }

  /** Factor by which heights are exaggerated: if it is not 1, the bar is valid for horizontal lengths only. */
  set exaggeration(factor: number) {
    this.heights = factor === 1 ? "" : `· heights × ${Number(factor.toPrecision(4))}`;
  }

  /** @param where place at which the scale holds; empty: everywhere */
  update(unitsPerPixel: number, where: string): void {
    const { text: length, pixels } = barOf(unitsPerPixel, this.units);
    const text = [length, where, this.heights].filter(Boolean).join(" ");
    if (this.text.textContent !== text) this.text.textContent = text;
    this.bar.style.width = `${pixels.toFixed(1)}px`;
  }

  /** The bar for a picture with this scale. */
  in(unitsPerPixel: number, widest: number): { readonly text: string; readonly pixels: number } {
    const { text, pixels } = barOf(unitsPerPixel, this.units, widest);
    return { text: `${text} ${this.heights}`.trim(), pixels };
  }
}

function barOf(unitsPerPixel: number, unit: string, widest = WIDEST): { readonly text: string; readonly pixels: number } {
  const { length, pixels } = scaleBar(unitsPerPixel, widest);
  return { text: `${tickText(length, roundBelow(length))} ${unit === "" ? "world units" : unit}`, pixels };
}
