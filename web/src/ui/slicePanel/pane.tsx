/** One of the slices beside the picture: samples, outlines of surfaces, the crosshair, and what is at its sides. */

import { isEqual } from "../../protocol/equal";
import { createEffect, createMemo, createSignal, For, on, onCleanup, onMount, Show } from "solid-js";
import { draggedWindow } from "../../slices/window";
import { indicesAtPixel, pixelOf, type Fit, type SliceView } from "../../slices/view";
import { keptInSight, panned, zoomedAt, zoomedFit, type SliceZoom } from "../../slices/zoom";
import type { VolumeInfo } from "../../protocol/types";
import { sampleRange } from "../../state/bounds";
import { hasLabels } from "../../state/fields";
import { isLed } from "../../state/group";
import { crosshairOf, moved, outlinesOf, pointed, sampleNear, type SliceState } from "../../state/slicing";
import { useModel } from "../model";
import type { Triple } from "../../world/places";
import { Icon } from "../widgets/icon";
import { drawSlice, fitOf, OUTLINE, outlineIn, type DrawnOutline, type Drawing } from "./draw";
import { listenToSlice, type Place, type SliceGestures } from "./gestures";
import { useShownField, useWindow } from "./shown";

const WINDOW_GESTURE = "slice-window";
/** Pixels between the crosshair's lines and the sample in their middle. */
const GAP = 6;

/** A sample by indices along a view's axes. */
function sampleOf({ axes, across }: SliceView, [i, j]: readonly [number, number], plane: number): Triple {
  const index = (axis: 0 | 1 | 2) => (axis === across ? plane : axis === axes[0] ? i : j);
  return [index(0), index(1), index(2)];
}

interface PaneProps {
  readonly view: SliceView;
  readonly volume: VolumeInfo;
  readonly isChosen: boolean;
  readonly onHover: (index: Triple | undefined) => void;
}

/** Size of an element, pixels of the page. */
function useSize(): readonly [() => readonly [number, number], (element: HTMLElement) => void] {
  const [size, setSize] = createSignal<readonly [number, number]>([0, 0]);
  const observe = (element: HTMLElement) => {
    const observer = new ResizeObserver(() => setSize([element.clientWidth, element.clientHeight]));
    observer.observe(element);
    onCleanup(() => observer.disconnect());
  };
  return [size, observe];
}

export function SlicePane(props: PaneProps) {
  const { page, slices } = useModel();
  const [size, observe] = useSize();
  const dims = () => props.volume.geometry.dims;
  const at = () => crosshairOf(page().slicing, dims());
  const state = () => slices()[props.view.across];
  const { fit, zoom, does: zoomDoes } = useZoom(props, size, at);
  const cross = () => pixelOf(props.view, fit(), at()[props.view.axes[0]], at()[props.view.axes[1]]);
  const last = () => dims()[props.view.across] - 1;
  const words = () => `${at()[props.view.across]} of ${last()}`;
  const { drawing, isTooFine } = useDrawing(props, state);
  let canvas: HTMLCanvasElement | undefined;
  onMount(() => canvas?.parentElement && observe(canvas.parentElement));
  createEffect(() => {
    const [[width, height], now, place] = [size(), drawing(), fit()];
    // With the next frame, once for all that changes until then.
    const frame = requestAnimationFrame(() => {
      if (canvas !== undefined && width > 0 && height > 0) drawSlice(canvas, width, height, window.devicePixelRatio, now, place);
    });
    onCleanup(() => cancelAnimationFrame(frame));
  });
  const gestures = { ...useGestures(props, fit, () => {
    const isZoomed = zoom() !== undefined;
    if (isZoomed) zoomDoes.onZoom(undefined, 0);
    return isZoomed;
  }), ...zoomDoes };
  return (
    <div class="slice-pane" classList={{ chosen: props.isChosen, old: state()?.isCurrent === false }}>
      <canvas
        ref={(element) => {
          canvas = element;
          listenToSlice(element, gestures);
        }}
        class="slice-picture"
        tabindex={0}
        role="img"
        aria-label={`${props.view.name} slice, ${words()}: click or arrow keys to move the crosshair, wheel or Page Up and Page Down for other slices, Control with the wheel or plus and minus to zoom, right-drag for window and level`}
      />
      <Lines cross={cross()} size={size()} />
      <For each={["left", "right", "top", "bottom"] as const}>{(side, i) => <span class={`slice-side ${side}`}>{props.view.sides[i()]}</span>}</For>
      <p class="slice-name">
        <b>{props.view.name}</b> {at()[props.view.across]} <span class="of">of {last()}</span>
        <Show when={zoom()}>{(of) => <span class="slice-zoom">× {Number(of().factor.toPrecision(2))}</span>}</Show>
        <Show when={state()?.isCurrent === false && state()?.loaded}>{(loaded) => <span class="slice-old">old: {loaded().index}</span>}</Show>
      </p>
      <Show when={isTooFine()}>
        <p class="slice-note">An outline is too fine to be drawn here</p>
      </Show>
      <Steps view={props.view} />
    </div>
  );
}

function Lines(props: { readonly cross: Place; readonly size: readonly [number, number] }) {
  const [x, y] = [() => Math.round(props.cross[0]) + 0.5, () => Math.round(props.cross[1]) + 0.5];
  const path = () => `M0 ${y()}H${x() - GAP}M${x() + GAP} ${y()}H${props.size[0]}M${x()} 0V${y() - GAP}M${x()} ${y() + GAP}V${props.size[1]}`;
  return (
    <svg class="slice-lines" aria-hidden="true">
      <path class="edge" d={path()} />
      <path d={path()} />
    </svg>
  );
}

/** For touch screens, and for users without a wheel. */
function Steps(props: { readonly view: SliceView }) {
  const { actions, group, page, volume } = useModel();
  const step = (by: number) => {
    const known = volume();
    if (known !== undefined) actions.changePage({ slicing: moved(page().slicing, known.geometry.dims, props.view.across, by * props.view.onward) });
  };
  return (
    <span class="slice-steps">
      <button type="button" disabled={isLed(group())} aria-label={`Previous ${props.view.name.toLowerCase()} slice`} title="Previous slice · Page Down" on:click={() => step(-1)}>
        <Icon name="chevron" />
      </button>
      <button type="button" class="onward" disabled={isLed(group())} aria-label={`Next ${props.view.name.toLowerCase()} slice`} title="Next slice · Page Up" on:click={() => step(1)}>
        <Icon name="chevron" />
      </button>
    </span>
  );
}

/** What is drawn; it changes only if that does. Some outlines may be too fine for it. */
function useDrawing(props: PaneProps, state: () => SliceState | undefined): { readonly drawing: () => Drawing | undefined; readonly isTooFine: () => boolean } {
  const { surfaces } = useModel();
  const field = useShownField();
  const shownWindow = useWindow();
  const wanted = createMemo(() => outlinesOf(surfaces()), undefined, { equals: isEqual });
  const loaded = createMemo(() => state()?.loaded);
  const found = createMemo(() => {
    const slice = loaded();
    return slice === undefined ? [] : wanted().map((outline) => ({ color: outline.color ?? OUTLINE, segments: outlineIn(slice, outline, props.volume.fields) }));
  });
  const outlines = createMemo(() => found().flatMap(({ color, segments }): DrawnOutline[] => (segments === undefined ? [] : [{ color, segments }])));
  const drawing = () => {
    const slice = loaded();
    const info = props.volume.fields.find(({ name }) => name === field());
    const isSmooth = info === undefined || !hasLabels(info);
    return slice && { view: props.view, loaded: slice, field: field(), window: shownWindow(), isSmooth, outlines: outlines() };
  };
  return { drawing, isTooFine: () => outlines().length < found().length };
}

/** A part of the slice, larger; the crosshair stays in sight. */
function useZoom(props: PaneProps, size: () => readonly [number, number], at: () => Triple) {
  const [zoom, setZoom] = createSignal<SliceZoom>();
  const whole = () => fitOf(props.view, ...size());
  const fit = createMemo(() => zoomedFit(whole(), size(), zoom()));
  const crosshair = () => [at()[props.view.axes[0]], at()[props.view.axes[1]]] as const;
  createEffect(on(at, () => setZoom(keptInSight(props.view, whole(), size(), zoom(), ...crosshair())), { defer: true }));
  const does: Pick<SliceGestures, "onPan" | "onZoom"> = {
    onZoom: (place, by) => setZoom(zoomedAt(whole(), size(), zoom(), place ?? pixelOf(props.view, fit(), ...crosshair()), by)),
    onPan: (right, down) => setZoom(panned(whole(), zoom(), [right, down])),
  };
  return { fit, zoom, does };
}

/** @param endZoom shows the whole slice; whether a part was shown */
function useGestures(props: PaneProps, fit: () => Fit, endZoom: () => boolean): Omit<SliceGestures, "onPan" | "onZoom"> {
  const { actions, group, look, page, volume } = useModel();
  const field = useShownField();
  const shownWindow = useWindow();
  let before = shownWindow();
  const dims = () => props.volume.geometry.dims;
  const indexAt = ([x, y]: Place): Triple => {
    const { view } = props;
    return sampleNear(dims(), sampleOf(view, indicesAtPixel(view, fit(), x, y), crosshairOf(page().slicing, dims())[view.across]));
  };
  const isOff = () => isLed(group());
  const move = (axis: 0 | 1 | 2, by: number) => {
    if (isOff()) return;
    actions.changePage({ slicing: moved(page().slicing, dims(), axis, by) });
    // The pointer is over a sample of another slice now.
    props.onHover(undefined);
  };
  return {
    onPoint: (place) => {
      if (isOff()) return;
      const slicing = pointed(page().slicing, dims(), indexAt(place));
      if (slicing !== page().slicing) actions.changePage({ slicing });
      props.onHover(undefined);
    },
    onHover: (place) => props.onHover(place && indexAt(place)),
    onWindow: (right, down) => {
      if (isOff()) return;
      const known = volume();
      const [low, high] = known?.fields.some(({ name }) => name === field()) === true ? sampleRange(known, field()) : before;
      actions.changeLook({ slices: { ...look().slices, window: draggedWindow(before, right, down, high - low || 1) } }, WINDOW_GESTURE);
    },
    onWindowEnd: (isOver) => {
      before = shownWindow();
      if (isOver) actions.endGesture();
    },
    onReset: () => {
      if (endZoom()) return;
      if (!isOff()) actions.changeLook({ slices: { ...look().slices, window: undefined } });
    },
    onScroll: (by) => move(props.view.across, by * props.view.onward),
    onStep: (right, down) => {
      const { axes, signs } = props.view;
      if (right !== 0) move(axes[0], right * signs[0]);
      if (down !== 0) move(axes[1], down * signs[1]);
    },
  };
}
