/** The inspector: cards beside the picture; on a narrow page a row of icons, and one card in a sheet. */

import { Collapsible } from "@kobalte/core/collapsible";
import { createSignal, For, onCleanup, Show, Suspense } from "solid-js";
import { Dynamic } from "solid-js/web";
import type { Card } from "./cards/card";
import { CARDS } from "./cards/registry";
import { useModel } from "./model";
import { isLed } from "../state/group";
import { Needs } from "./needs";
import { useSurfaceName } from "./surfaceNames";
import { IconButton } from "./widgets/button";
import { Icon } from "./widgets/icon";

/** As in `narrow.css`. */
const NARROW = "(max-width: 760px)";

function useNarrow(): () => boolean {
  const query = window.matchMedia(NARROW);
  const [narrow, setNarrow] = createSignal(query.matches);
  const follow = () => setNarrow(query.matches);
  query.addEventListener("change", follow);
  onCleanup(() => query.removeEventListener("change", follow));
  return narrow;
}

export function Inspector() {
  const model = useModel();
  const narrow = useNarrow();
  const cards = () => CARDS.filter((card) => card.when?.(model) ?? true);
  return (
    <Show when={narrow()} fallback={<Column cards={cards()} />}>
      <Sheet cards={cards()} />
    </Show>
  );
}

/** All that edits the view is off until there is one. */
function Column(props: { readonly cards: readonly Card[] }) {
  const { page, view } = useModel();
  return (
    <aside class="inspector" aria-label="Inspector" hidden={!page().inspector}>
      <fieldset class="cards" disabled={view() === undefined} aria-label="Controls">
        <For each={props.cards}>{(card) => <FoldingCard card={card} />}</For>
      </fieldset>
    </aside>
  );
}

function FoldingCard(props: { readonly card: Card }) {
  const { actions, page } = useModel();
  const { id, title, folded } = props.card;
  const isFolded = () => page().folded[id] ?? folded ?? false;
  let section: HTMLElement | undefined;
  const onOpenChange = (open: boolean) => {
    actions.changePage({ folded: { ...page().folded, [id]: !open } });
    if (open && section !== undefined) showGrowing(section);
  };
  return (
    <Collapsible
      ref={(element: HTMLElement) => (section = element)}
      as="section"
      class="card"
      data-tour={id}
      aria-label={title}
      open={!isFolded()}
      onOpenChange={onOpenChange}
    >
      <h2>
        <Collapsible.Trigger class="card-head">
          {title}
          <OfSurface card={props.card} />
          <Icon name="chevron" />
        </Collapsible.Trigger>
      </h2>
      <Collapsible.Content class="card-body">
        <Suspense>
          <CardBody card={props.card} />
        </Suspense>
      </Collapsible.Content>
    </Collapsible>
  );
}

/** How long a card grows that is unfolded: its body may have to be loaded. */
const GROWING_MS = 1000;

/** Keeps an unfolded section in sight while it grows, or only its head if it is higher than the column. */
function showGrowing(section: HTMLElement): void {
  const show = () => {
    const column = section.parentElement?.parentElement;
    const isHigh = column !== null && column !== undefined && section.offsetHeight > column.clientHeight;
    section.scrollIntoView({ block: isHigh ? "start" : "nearest" });
  };
  const observer = new ResizeObserver(show);
  observer.observe(section);
  setTimeout(() => observer.disconnect(), GROWING_MS);
}

/** While another one's picture is shown, what would change it is off. */
function CardBody(props: { readonly card: Card }) {
  const { group } = useModel();
  const { needs, body, isLocal } = props.card;
  const isOff = () => isLocal !== true && isLed(group());
  return (
    <fieldset class="led" disabled={isOff()} inert={isOff()}>
      <Show when={needs} fallback={<Dynamic component={body} />}>
        {(role) => (
          <Needs role={role()}>
            <Dynamic component={body} />
          </Needs>
        )}
      </Show>
    </fieldset>
  );
}

/** Name of the surface that the card is about, if there are several. */
function OfSurface(props: { readonly card: Card }) {
  const name = useSurfaceName();
  return <Show when={props.card.isOfSurface === true && name()}>{(text) => <span class="of-surface">{text()}</span>}</Show>;
}

function Sheet(props: { readonly cards: readonly Card[] }) {
  const { actions, page, view } = useModel();
  const open = () => props.cards.find(({ id }) => id === page().sheet);
  return (
    <aside class="sheet" aria-label="Inspector">
      <Show when={open()} keyed>
        {(card) => (
          <section class="card" aria-label={card.title}>
            <div class="sheet-head">
              <h2>
                {card.title} <OfSurface card={card} />
              </h2>
              <IconButton icon="close" label="Close" onClick={() => actions.changePage({ sheet: undefined })} />
            </div>
            <fieldset class="card-body" disabled={view() === undefined} aria-label={card.title}>
              <Suspense>
                <CardBody card={card} />
              </Suspense>
            </fieldset>
          </section>
        )}
      </Show>
      <nav class="card-icons" aria-label="Cards">
        <For each={props.cards}>
          {({ id, title, icon }) => (
            <button
              type="button"
              class="card-icon"
              data-tour={id}
              aria-pressed={page().sheet === id}
              on:click={() => actions.changePage({ sheet: page().sheet === id ? undefined : id })}
            >
              <Icon name={icon} />
              <span>{title}</span>
            </button>
          )}
        </For>
      </nav>
    </aside>
  );
}
