/** Three steps for those who see the page for the first time. Nothing is covered or locked: the page works all the while. */

import { createEffect, createSignal, onCleanup, onMount, Show, untrack } from "solid-js";
import { allTriangles } from "../state/counts";
import { formatCount, formatShare } from "./format";
import { useModel, type Model } from "./model";
import { endTour, hasTried, setStep, setTried, step } from "./tourState";
import { Button } from "./widgets/button";
import { Toggle } from "./widgets/choice";

interface Step {
  /** `data-tour` of what it is about. */
  readonly at: string;
  readonly title: string;
  readonly text: (model: Model) => string;
  /** Triangles are seen one by one. */
  readonly wireframe?: boolean;
  /** The user tries what it is about. */
  readonly tries?: boolean;
}

/** Triangles of the surface of which a part is marked: so few that edges are seen. */
const TRIED_TRIANGLES = 20_000;
/** Radius of the part, as a share of the volume's longest side. */
const TRIED_RADIUS = 0.1;
/** Of the rest: what its importance becomes. */
const REST = 0.1;

const partOf = (triangles: number, all: number) => `${formatShare(triangles / Math.max(1, all))} of ${formatCount(all)}`;

const STEPS: readonly Step[] = [
  {
    at: "picture",
    title: "A surface, with fewer triangles",
    text: ({ viewer }) => {
      const { statistics } = viewer();
      const part = statistics === undefined ? "a part" : partOf(statistics.triangles, allTriangles(statistics));
      return `isopeel makes the surface inside a volume with only the triangles that show something: here ${part}. Drag to turn it, scroll to zoom.`;
    },
  },
  {
    at: "detail",
    title: "How fine",
    wireframe: true,
    text: () => "Drag this slider: from a thousandth of the triangles to all of them, whose edges are drawn meanwhile. The line above says how far the surface is off.",
  },
  {
    at: "matters",
    title: "What stays fine",
    wireframe: true,
    tries: true,
    text: () => "Choose what is important: the shape, edges in the data, another field, or a place. It keeps its triangles, the rest gives them up. Mark a place and see them move.",
  },
];

/** Few triangles, nothing of much importance, and a tool in hand that marks what has it; a first mark is at the picture's centre. */
function markCentre({ actions, extent, view }: Model): void {
  const points = view()?.transferFunction.points.map((point) => ({ ...point, importance: REST * point.importance }));
  if (points === undefined) return;
  actions.edit({ triangles: TRIED_TRIANGLES, transferFunction: { points } });
  actions.changeLook({ colorBy: "importance", map: "ylor" });
  actions.changePage({ tool: "paint", brush: Number((TRIED_RADIUS * extent()).toPrecision(2)) });
  actions.useAtCentre();
}

/** Same width as in `over.css`. It is not set as a style here: a constant style would be inlined in the page, which its policy forbids. */
const WIDTH = 320;
const GAP = 14;

/** Position of the card: beside the step's target, or over the picture's lower edge if the target is the picture or the page is narrow. */
function place(at: string, card: HTMLElement | undefined): { readonly left: number; readonly top: number } {
  const target = document.querySelector(`[data-tour="${at}"]`)?.getBoundingClientRect();
  const height = card?.offsetHeight ?? 200;
  const inside = (value: number, size: number, all: number) => Math.round(Math.max(GAP, Math.min(all - size - GAP, value)));
  if (target === undefined || at === "picture" || target.left < WIDTH + 2 * GAP) {
    const middle = at === "picture" && target !== undefined ? target.left + target.width / 2 : window.innerWidth / 2;
    return { left: inside(middle - WIDTH / 2, WIDTH, window.innerWidth), top: inside(window.innerHeight - height - 90, height, window.innerHeight) };
  }
  return { left: target.left - WIDTH - GAP, top: inside(target.top, height, window.innerHeight) };
}

/** Draws edges while a step is about them, and after a part was marked; else they are as before when the tour goes away. */
function useWireframe({ actions, look }: Model, isWanted: () => boolean): void {
  const had = look().wireframe;
  createEffect(() => {
    const wireframe = had || hasTried() || isWanted();
    if (untrack(look).wireframe !== wireframe) actions.changeLook({ wireframe });
  });
  onCleanup(() => {
    if (!had && !hasTried() && look().wireframe) actions.changeLook({ wireframe: false });
  });
}

export default function Tour(props: { readonly onEnd: () => void }) {
  const model = useModel();
  const [corner, setCorner] = createSignal({ left: 0, top: 0 });
  let card: HTMLElement | undefined;
  const now = () => STEPS[step()] ?? STEPS[0];
  useWireframe(model, () => now()?.wireframe === true);
  const end = () => {
    endTour();
    if (model.comparing() === "importance") model.actions.compare(undefined);
    props.onEnd();
    setStep(0);
    setTried(false);
  };
  // The help, or following, takes the tour's place for a while.
  onCleanup(() => {
    if (hasTried() && model.page().tool === "paint") model.actions.changePage({ tool: undefined });
  });
  const mark = () => {
    setTried(true);
    markCentre(model);
  };
  const settle = () => setCorner(place(now()?.at ?? "", card));
  createEffect(settle);
  onMount(() => {
    if (hasTried() && model.page().tool === undefined) model.actions.changePage({ tool: "paint" });
    window.addEventListener("resize", settle);
    onCleanup(() => window.removeEventListener("resize", settle));
  });
  return (
    <section
      ref={(element) => (card = element)}
      class="tour"
      role="dialog"
      aria-label="Tour"
      style={{ left: `${corner().left}px`, top: `${corner().top}px` }}
      on:keydown={(event) => {
        if (event.key === "Escape") end();
      }}
    >
      <h2>{now()?.title}</h2>
      <p>{now()?.text(model)}</p>
      <Show when={now()?.tries && model.may("edit")}>
        <Trial hasTried={hasTried()} onTry={mark} />
      </Show>
      <div class="tour-foot">
        <span class="note">
          {step() + 1} of {STEPS.length}
        </span>
        <span class="spring" />
        <Button quiet onClick={end}>
          Skip
        </Button>
        <Button onClick={() => (step() + 1 < STEPS.length ? setStep(step() + 1) : end())}>{step() + 1 < STEPS.length ? "Next" : "Done"}</Button>
      </div>
    </section>
  );
}

/** Marks a part, and then shows what its importance brings. */
function Trial(props: { readonly hasTried: boolean; readonly onTry: () => void }) {
  const { actions, comparing } = useModel();
  return (
    <Show when={props.hasTried} fallback={<Button onClick={props.onTry}>Mark the middle</Button>}>
      <p class="note">Click elsewhere to mark more</p>
      <Toggle label="Same budget without importance" on={comparing() === "importance"} onChange={(on) => actions.compare(on ? "importance" : undefined)} />
    </Show>
  );
}
