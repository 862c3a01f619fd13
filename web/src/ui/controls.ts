/** Form controls. `set` changes the value shown; `onChange` is called for the user's changes only. */

import { h, uniqueId } from "./dom";
import { formatValue, parseValue } from "./format";

/** A text field for a number. The value changes on Enter or when the field loses focus; Escape restores it. */
export class NumberField {
  readonly element: HTMLInputElement;
  private value = NaN;

  constructor(
    label: string,
    private readonly options: {
      readonly min?: number;
      readonly max?: number;
      /** Arrow keys change by this much; Shift by ten times. */
      readonly step?: () => number;
      readonly onChange: (value: number) => void;
    },
  ) {
    this.element = h("input", {
      class: "number",
      type: "text",
      inputmode: "decimal",
      autocomplete: "off",
      spellcheck: "false",
      "aria-label": label,
    });
    this.element.addEventListener("change", () => this.commit());
    this.element.addEventListener("blur", () => this.commit());
    this.element.addEventListener("input", () => {
      this.element.classList.toggle("invalid", this.read() === undefined);
    });
    this.element.addEventListener("focus", () => this.element.select());
    this.element.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.show();
      if (event.key === "Enter") this.commit();
      if (event.key === "ArrowUp" || event.key === "ArrowDown") {
        event.preventDefault();
        const step = (this.options.step?.() ?? 1) * (event.shiftKey ? 10 : 1);
        const value = (this.read() ?? this.value) + (event.key === "ArrowUp" ? step : -step);
        this.accept(this.clamp(value));
      }
    });
  }

  set(value: number): void {
    if (Object.is(this.value, value)) return;
    // The user's unfinished text is not overwritten.
    const typing = document.activeElement === this.element && this.element.value !== formatValue(this.value);
    this.value = value;
    if (!typing) this.show();
  }

  set disabled(disabled: boolean) {
    this.element.disabled = disabled;
  }

  private read(): number | undefined {
    const value = parseValue(this.element.value);
    return value === undefined || value !== this.clamp(value) ? undefined : value;
  }

  private clamp(value: number): number {
    return Math.min(this.options.max ?? Infinity, Math.max(this.options.min ?? -Infinity, value));
  }

  private commit(): void {
    if (this.element.value === formatValue(this.value)) return this.show();
    const typed = parseValue(this.element.value);
    // A value out of bounds becomes the bound; text that is no number is replaced by the value before.
    if (typed === undefined) this.show();
    else this.accept(this.clamp(typed));
  }

  private accept(value: number): void {
    const rounded = Number(formatValue(value, 7));
    const changed = rounded !== this.value;
    this.value = rounded;
    this.show();
    if (changed) this.options.onChange(rounded);
  }

  private show(): void {
    this.element.value = formatValue(this.value);
    this.element.classList.remove("invalid");
  }
}

/** Maps a slider's position, 0 to 1, to values and back. */
export interface Scale {
  readonly toValue: (position: number) => number;
  readonly toPosition: (value: number) => number;
}

export const LINEAR: Scale = { toValue: (t) => t, toPosition: (v) => v };

const SLIDER_STEPS = 1000;

/** A labelled slider with a number field beside it. */
export class Slider {
  readonly element: HTMLElement;
  private readonly range: HTMLInputElement;
  private readonly field: NumberField;
  private readonly note = h("span", { class: "note" });

  constructor(
    label: string,
    hint: string,
    private readonly options: {
      readonly scale: Scale;
      readonly min: number;
      readonly max: number;
      readonly step: () => number;
      /** Note beside the label. */
      readonly describe?: (value: number) => string | undefined;
      readonly onChange: (value: number) => void;
    },
  ) {
    const id = uniqueId("slider");
    this.range = h("input", { id, type: "range", min: 0, max: SLIDER_STEPS, step: 1, title: hint });
    this.field = new NumberField(label, {
      min: options.min,
      max: options.max,
      step: options.step,
      onChange: (value) => this.changed(value),
    });
    this.range.addEventListener("input", () => {
      this.changed(options.scale.toValue(Number(this.range.value) / SLIDER_STEPS));
    });
    this.element = h(
      "div",
      { class: "control" },
      h("div", { class: "control-head" }, h("label", { for: id, title: hint }, label), this.note, this.field.element),
      this.range,
    );
  }

  set(value: number): void {
    const position = Math.round(this.options.scale.toPosition(value) * SLIDER_STEPS);
    if (Number(this.range.value) !== position) this.range.value = String(position);
    this.range.style.setProperty("--fill", `${position / (SLIDER_STEPS / 100)}%`);
    this.field.set(value);
    const note = this.options.describe?.(value) ?? "";
    this.note.textContent = note;
    this.range.setAttribute("aria-valuetext", note === "" ? formatValue(value) : note);
  }

  set disabled(disabled: boolean) {
    this.range.disabled = disabled;
    this.field.disabled = disabled;
    this.element.classList.toggle("disabled", disabled);
  }

  private changed(value: number): void {
    this.set(value);
    this.options.onChange(value);
  }
}

/** One of a few choices: a radio group that looks like a row of buttons. */
export class Segmented<T extends string | number> {
  readonly element: HTMLElement;
  private readonly inputs = new Map<T, HTMLInputElement>();

  constructor(
    label: string,
    choices: readonly { readonly value: T; readonly text: string; readonly hint?: string; readonly swatch?: string }[],
    onChange: (value: T) => void,
  ) {
    const name = uniqueId("choice");
    this.element = h("div", { class: "segmented", role: "radiogroup", "aria-label": label });
    for (const { value, text, hint, swatch } of choices) {
      const input = h("input", { type: "radio", name, value });
      input.addEventListener("change", () => onChange(value));
      this.inputs.set(value, input);
      const chip = swatch === undefined ? undefined : h("i", { class: "swatch", style: `background:${swatch}` });
      this.element.append(h("label", { title: hint }, input, h("span", {}, chip, text)));
    }
  }

  set(value: T): void {
    const input = this.inputs.get(value);
    if (input !== undefined) input.checked = true;
  }
}

/** A drop-down list. */
export class Select {
  readonly element: HTMLElement;
  private readonly select: HTMLSelectElement;
  private listed = "";

  constructor(label: string, hint: string, onChange: (value: string) => void) {
    const id = uniqueId("select");
    this.select = h("select", { id, title: hint });
    this.select.addEventListener("change", () => onChange(this.select.value));
    this.element = h("div", { class: "control row" }, h("label", { for: id, title: hint }, label), this.select);
  }

  set(choices: readonly { readonly value: string; readonly text: string }[], value: string | undefined): void {
    const listed = JSON.stringify(choices);
    if (listed !== this.listed) {
      this.listed = listed;
      this.select.replaceChildren(...choices.map((c) => h("option", { value: c.value }, c.text)));
    }
    if (value !== undefined && this.select.value !== value) this.select.value = value;
    // With one entry there is nothing to choose.
    this.select.disabled = choices.length < 2;
  }
}

/** A check box. */
export class Toggle {
  readonly element: HTMLElement;
  private readonly input: HTMLInputElement;

  constructor(text: string, hint: string, onChange: (on: boolean) => void) {
    this.input = h("input", { type: "checkbox" });
    this.input.addEventListener("change", () => onChange(this.input.checked));
    this.element = h("label", { class: "toggle", title: hint }, this.input, h("span", {}, text));
  }

  set(on: boolean): void {
    this.input.checked = on;
  }
}

export function button(text: string, hint: string, onClick: () => void, className = "button"): HTMLButtonElement {
  const element = h("button", { type: "button", class: className, title: hint }, text);
  element.addEventListener("click", onClick);
  return element;
}
