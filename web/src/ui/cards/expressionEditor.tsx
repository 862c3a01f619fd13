/** An expression over fields: typed, with what is wrong at its character, and fields and functions to choose from. */

import { createEffect, createSignal, createUniqueId, For, on, onCleanup, Show } from "solid-js";
import { EXPRESSION_FUNCTIONS } from "../../protocol/generated";
import type { FieldInfo } from "../../protocol/types";
import { asOperand, inserted, pointedAt, type Fault } from "../../state/expressions";
import { useDescribed } from "../expressions";
import { formatValue } from "../format";
import { useModel } from "../model";
import { Button } from "../widgets/button";
import { label } from "./features";

/** The server is asked when typing pauses for so long. */
const PAUSE_MS = 350;

interface Props {
  readonly label: string;
  /** The expression in force; empty if there is none. */
  readonly value: string;
  readonly onUse: (info: FieldInfo) => void;
  readonly onClose: () => void;
}

export function ExpressionEditor(props: Props) {
  const { volume } = useModel();
  const { text, type, settle, info, fault } = typedExpression(() => props.value);
  const use = () => {
    const known = info();
    if (known !== undefined) props.onUse(known);
    // Before the pause is over: the answer comes at once, and Enter is pressed again.
    else settle();
  };
  let input: HTMLInputElement | undefined;
  const insert = (word: string) => {
    if (input === undefined) return;
    const { text: typed, cursor } = inserted(text(), [input.selectionStart ?? 0, input.selectionEnd ?? 0], word);
    type(typed);
    input.value = typed;
    input.focus();
    input.setSelectionRange(cursor, cursor);
  };
  const note = createUniqueId();
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Enter") use();
    if (event.key !== "Escape") return;
    event.stopPropagation();
    props.onClose();
  };
  return (
    <div class="expression" role="group" aria-label={props.label}>
      <div class="control row">
        <input
          ref={(element) => (input = element)}
          class="number wide"
          classList={{ invalid: fault() !== undefined }}
          type="text"
          autocomplete="off"
          spellcheck={false}
          aria-label={props.label}
          aria-invalid={fault() !== undefined}
          aria-describedby={note}
          placeholder="log(rho) + 1"
          value={text()}
          on:input={(event) => type(event.currentTarget.value)}
          on:keydown={onKeyDown}
        />
        <Button onClick={use} disabled={info() === undefined || info()?.name === props.value}>
          Use
        </Button>
        <Button quiet onClick={() => props.onClose()}>
          Close
        </Button>
      </div>
      <div id={note} aria-live="polite">
        <Show when={fault()}>{(wrong) => <FaultNote text={text()} fault={wrong()} />}</Show>
        <Show when={info()}>{(known) => <p class="note">{valuesText(known())}</p>}</Show>
      </div>
      <Words title="Fields" words={(volume()?.fields ?? []).map(({ name }) => ({ word: asOperand(name), text: label(name) }))} onChoose={insert} />
      <Words title="Functions" words={EXPRESSION_FUNCTIONS.map((name) => ({ word: `${name}()`, text: name }))} onChoose={insert} />
    </div>
  );
}

/** What is typed, and what the server says of it once typing pauses. */
function typedExpression(inForce: () => string) {
  const [text, setText] = createSignal(inForce());
  const [asked, setAsked] = createSignal(inForce());
  createEffect(on(inForce, (value) => [setText(value), setAsked(value)], { defer: true }));
  let timer: ReturnType<typeof setTimeout> | undefined;
  onCleanup(() => clearTimeout(timer));
  const type = (typed: string) => {
    setText(typed);
    clearTimeout(timer);
    timer = setTimeout(() => setAsked(typed), PAUSE_MS);
  };
  const settle = () => setAsked(text());
  const isBlank = (expression: string) => expression.trim() === "";
  const answer = useDescribed(() => (isBlank(asked()) ? undefined : asked()));
  /** The answer, if it is about the typed text. */
  const current = () => (asked() === text() ? answer() : undefined);
  const info = () => (current()?.text === text() ? current()?.info : undefined);
  const fault = () => (current()?.text === text() && !isBlank(text()) ? current()?.fault : undefined);
  return { text, type, settle, info, fault };
}

function FaultNote(props: { readonly text: string; readonly fault: Fault }) {
  return (
    <>
      <Show when={props.fault.at !== undefined}>
        <pre class="fault">{pointedAt(props.text, props.fault.at ?? 0)}</pre>
      </Show>
      <p class="note fault-text">{props.fault.why}</p>
    </>
  );
}

/** What an expression gives, in words. */
export function valuesText({ range: [low, high], unit }: Pick<FieldInfo, "range" | "unit">): string {
  return low < high ? `Values from ${formatValue(low, 4)} to ${formatValue(high, 4)}${unit === null ? "" : ` ${unit}`}` : "All values are equal, or none is a number";
}

function Words(props: { readonly title: string; readonly words: readonly { readonly word: string; readonly text: string }[]; readonly onChoose: (word: string) => void }) {
  return (
    <div class="chips" role="group" aria-label={props.title}>
      <For each={props.words}>
        {({ word, text }) => (
          <button type="button" class="chip" on:click={() => props.onChoose(word)}>
            {text}
          </button>
        )}
      </For>
    </div>
  );
}
