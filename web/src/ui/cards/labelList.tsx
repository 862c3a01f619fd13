/** Labels in rows of one height, of which only those in sight are in the page: there may be thousands. One stop of the Tab key; arrows go on. */

import { createEffect, createSignal, For, on, Show, type JSX } from "solid-js";
import type { LabelEntry } from "../../state/labels";
import { Icon, type IconName } from "../widgets/icon";

/** Pixels, as in `labels.css`. */
const ROW = 28;
const ROWS_IN_SIGHT = 9;
/** Rows beyond those in sight, so that scrolling shows no gap. */
const MORE = 4;

/** A switch of each label. */
export interface LabelSwitch {
  readonly icon: IconName;
  /** While it is off. */
  readonly offIcon?: IconName;
  /** What it is for, in few words. */
  readonly short: string;
  readonly text: (label: LabelEntry) => string;
  readonly isOn: (label: LabelEntry) => boolean;
  readonly onClick: (label: LabelEntry) => void;
}

interface Props {
  readonly labels: readonly LabelEntry[];
  readonly switches: readonly LabelSwitch[];
  /** Behind the name. */
  readonly note: (label: LabelEntry) => string;
}

/** Row and column to which a key moves the focus; `undefined` for other keys. */
function keyed(key: string, row: number, column: number): readonly [number, number] | undefined {
  const to: Readonly<Record<string, readonly [number, number]>> = {
    ArrowUp: [row - 1, column],
    ArrowDown: [row + 1, column],
    PageUp: [row - ROWS_IN_SIGHT, column],
    PageDown: [row + ROWS_IN_SIGHT, column],
    ArrowLeft: [row, column - 1],
    ArrowRight: [row, column + 1],
    Home: [0, column],
    End: [Infinity, column],
  };
  return to[key];
}

const bounded = (n: number, count: number) => Math.max(0, Math.min(count - 1, n));

export function LabelList(props: Props) {
  const [top, setTop] = createSignal(0);
  const [at, setAt] = createSignal<readonly [number, number]>([0, 0]);
  let scroller: HTMLDivElement | undefined;
  const first = () => Math.max(0, Math.min(Math.floor(top() / ROW) - MORE, props.labels.length - ROWS_IN_SIGHT - 2 * MORE));
  const shown = () => props.labels.slice(first(), first() + ROWS_IN_SIGHT + 2 * MORE);
  /** The row that Tab moves to: the user's last row if it is rendered, or else the first rendered one. */
  const stop = () => (at()[0] >= first() && at()[0] < first() + shown().length ? at()[0] : first());
  const scrollTo = (to: number) => {
    if (scroller !== undefined) scroller.scrollTop = to;
    setTop(to);
  };
  createEffect(on(() => props.labels, () => (scrollTo(0), setAt([0, 0])), { defer: true }));
  const go = ([row, column]: readonly [number, number]) => {
    const to = [bounded(row, props.labels.length), bounded(column, props.switches.length)] as const;
    const [begin, end] = [to[0] * ROW, (to[0] + 1 - ROWS_IN_SIGHT) * ROW];
    if (begin < top()) scrollTo(begin);
    else if (end > top()) scrollTo(end);
    setAt(to);
    scroller?.querySelector<HTMLElement>(`[data-row="${to[0]}"] button:nth-of-type(${to[1] + 1})`)?.focus({ preventScroll: true });
  };
  const onKey = (event: KeyboardEvent) => {
    const to = event.ctrlKey || event.metaKey || event.altKey ? undefined : keyed(event.key, ...at());
    if (to === undefined) return;
    event.preventDefault();
    go(to);
  };
  return (
    <div
      ref={(element) => (scroller = element)}
      class="label-list"
      role="grid"
      aria-label="Labels"
      aria-rowcount={props.labels.length}
      style={{ height: `${ROW * Math.min(ROWS_IN_SIGHT, props.labels.length)}px` }}
      on:scroll={(event) => setTop(event.currentTarget.scrollTop)}
      on:keydown={onKey}
    >
      <div class="label-space" role="presentation" style={{ height: `${ROW * props.labels.length}px` }}>
        <div role="rowgroup" style={{ translate: `0 ${ROW * first()}px` }}>
          <For each={shown()}>
            {(label, index) => <Row label={label} row={first() + index()} stop={first() + index() === stop() ? at()[1] : -1} note={props.note(label)} switches={props.switches} onFocus={setAt} />}
          </For>
        </div>
      </div>
    </div>
  );
}

function Row(props: {
  readonly label: LabelEntry;
  readonly row: number;
  /** The switch that Tab goes to; −1: none of this row. */
  readonly stop: number;
  readonly note: string;
  readonly switches: readonly LabelSwitch[];
  readonly onFocus: (at: readonly [number, number]) => void;
}): JSX.Element {
  const isUsed = () => props.switches.some(({ isOn }) => isOn(props.label));
  return (
    <div class="label-row" classList={{ used: isUsed() }} role="row" aria-rowindex={props.row + 1} data-row={props.row}>
      <span class="label-name" role="rowheader" title={`${props.label.name} · ${props.label.number}`}>
        <i class="swatch" style={{ background: props.label.color }} />
        <span class="clipped">{props.label.name}</span>
        <Show when={props.note}>
          <span class="note">{props.note}</span>
        </Show>
      </span>
      <span class="label-switches" role="gridcell">
        <For each={props.switches}>
          {({ icon, offIcon, text, isOn, onClick }, column) => (
            <button
              type="button"
              class="icon-button"
              tabindex={column() === props.stop ? 0 : -1}
              aria-label={text(props.label)}
              aria-pressed={isOn(props.label)}
              title={text(props.label)}
              on:focus={() => props.onFocus([props.row, column()])}
              on:click={() => onClick(props.label)}
            >
              <Icon name={isOn(props.label) ? icon : (offIcon ?? icon)} />
            </button>
          )}
        </For>
      </span>
    </div>
  );
}
