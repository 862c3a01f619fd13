/** Three steps for those who see the page for the first time. Nothing is covered or locked: the page works all the while. */

import { createEffect, createSignal, onCleanup, onMount } from "solid-js";
import { formatCount, formatShare } from "./format";
import { useModel, type Model } from "./model";
import { endTour } from "./tourState";
import { Button } from "./widgets/button";

interface Step {
  /** `data-tour` of what it is about. */
  readonly at: string;
  readonly title: string;
  readonly text: (model: Model) => string;
}

const STEPS: readonly Step[] = [
  {
    at: "picture",
    title: "A surface, with fewer triangles",
    text: ({ viewer }) => {
      const { statistics } = viewer();
      const share = statistics === undefined ? "a part" : formatShare(statistics.triangles / Math.max(1, statistics.fullTriangles));
      const full = statistics === undefined ? "" : ` of ${formatCount(statistics.fullTriangles)}`;
      return `isopeel makes the surface inside a volume with only the triangles that show something: here ${share}${full}. Drag to turn it, scroll to zoom.`;
    },
  },
  { at: "detail", title: "How fine", text: () => "Drag this slider: from a thousandth of the triangles to all of them. The line above says how far the surface is off." },
  { at: "matters", title: "What stays fine", text: () => "Say what matters: the shape, edges in the data, or another field. High points keep their triangles, low ones give them up." },
];

/** As in `over.css`: as a style here it would be a constant, which is put in the page's text, where the page's policy forbids it. */
const WIDTH = 320;
const GAP = 14;

/** Beside what the step is about; over the picture's lower edge where that is the picture, or the page is narrow. */
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

export default function Tour(props: { readonly onEnd: () => void }) {
  const model = useModel();
  const [step, setStep] = createSignal(0);
  const [corner, setCorner] = createSignal({ left: 0, top: 0 });
  let card: HTMLElement | undefined;
  const now = () => STEPS[step()] ?? STEPS[0];
  const end = () => {
    endTour();
    props.onEnd();
  };
  const settle = () => setCorner(place(now()?.at ?? "", card));
  createEffect(settle);
  onMount(() => {
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
