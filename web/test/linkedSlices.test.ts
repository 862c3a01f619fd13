import { expect, test } from "vitest";
import type { Plane, PlaneRequest } from "../src/net/slices";
import { contourOf, maskedBy } from "../src/slices/contours";
import { paintSlice, sampleAt, stridesOf } from "../src/slices/paint";
import { fitInto, indicesAt, indicesAtPixel, pixelOf, screenOf, sliceViews, type SliceView } from "../src/slices/view";
import { draggedWindow } from "../src/slices/window";
import { decodeLink, encodeLink } from "../src/state/link";
import { DEFAULT_LOOK } from "../src/state/look";
import { crosshairOf, fieldsOf, FIRST_SLICING, moved, nextLayout, outlinesOf, planesAt, pointed, type SliceState, type Slicing } from "../src/state/slicing";
import { ActingStore } from "./acting";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { outlineIn } from "../src/ui/slicePanel/draw";
import { WheelSteps } from "../src/ui/slicePanel/gestures";
import { positionWords, problemWords, valueWords } from "../src/ui/slicePanel/words";
import { SlicePlanes, type SlicesWanted } from "../src/wiring/slicePlanes";
import { crosshairPlace } from "../src/wiring/marks";
import { indexAt, indexOfEven, worldOf, type PlacedGrid } from "../src/world/places";
import { evenOf } from "../src/world/uneven";
import { OPENING, VOLUMES } from "./fixture";

const [volume, other] = VOLUMES;
if (volume === undefined || other === undefined) throw new Error("two volumes expected");

type Grid = PlacedGrid & { readonly frame: string };

const EVEN: Grid = { dims: [4, 5, 6], spacing: [1, 2, 3], origin: [10, 20, 30], direction: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], frame: "world" };
const UNEVEN: Grid = { ...EVEN, dims: [4, 3, 3], spacing: [2, 2, 3], positions: [[0, 1, 5, 6], null, [0, 1, 6]] };
/** Turned by 20° around z, and sheared along z. */
const [C, S] = [Math.cos(Math.PI / 9), Math.sin(Math.PI / 9)];
const SHEARED: Grid = { ...EVEN, direction: [[C, S, 0], [-S, C, 0], [0, 0.6, 0.8]], frame: "LPS" };

function near(found: readonly number[], expected: readonly number[], digits = 9) {
  expect(found.length).toBe(expected.length);
  found.forEach((value, i) => expect(value).toBeCloseTo(expected[i] ?? NaN, digits));
}

test("an index is at a place of the world, and back, whatever the axes are like", () => {
  expect(worldOf(EVEN, [1, 2, 3])).toEqual([11, 24, 39]);
  expect(worldOf(UNEVEN, [1.5, 0, 2])).toEqual([13, 20, 36]);
  for (const grid of [EVEN, UNEVEN, SHEARED]) {
    for (const index of [[0, 0, 0], [1.5, 2, 1.25], [-0.5, 2.4, 2], [3, 2, 2]] as const) near(indexAt(grid, worldOf(grid, index)), index);
  }
  const axis = [0, 0.5, 2.5, 3];
  for (const index of [-1, 0, 0.3, 1, 2.9, 3, 4]) expect(indexOfEven(axis, evenOf(axis, index))).toBeCloseTo(index);
});

const named = (views: readonly SliceView[]) => views.map(({ name, across, axes, signs, sides }) => ({ name, across, axes, signs, sides: sides.join("") }));

test("slices of a patient lie as radiologists have them, or as neurologists, whichever way the file's axes run", () => {
  // Along left, back and head.
  expect(named(sliceViews({ ...EVEN, frame: "LPS" }, false))).toEqual([
    { name: "Axial", across: 2, axes: [0, 1], signs: [1, 1], sides: "RLAP" },
    { name: "Coronal", across: 1, axes: [0, 2], signs: [1, -1], sides: "RLSI" },
    { name: "Sagittal", across: 0, axes: [1, 2], signs: [1, -1], sides: "APSI" },
  ]);
  expect(named(sliceViews({ ...EVEN, frame: "LPS" }, true)).map(({ sides }) => sides)).toEqual(["LRAP", "LRSI", "APSI"]);
  // RAS: the same sides, so the indices run the other way.
  const ras = named(sliceViews({ ...EVEN, frame: "RAS" }, false));
  expect(ras.map(({ sides }) => sides)).toEqual(["RLAP", "RLSI", "APSI"]);
  expect(ras.map(({ signs }) => signs)).toEqual([[-1, -1], [-1, -1], [-1, -1]]);
  // A sagittal series: the first axis runs to the back, the second to the feet, the third to the right.
  const sagittal: Grid = { ...EVEN, direction: [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], frame: "LPS" };
  expect(named(sliceViews(sagittal, false))).toEqual([
    { name: "Axial", across: 1, axes: [2, 0], signs: [-1, 1], sides: "RLAP" },
    { name: "Coronal", across: 0, axes: [2, 1], signs: [-1, 1], sides: "RLSI" },
    { name: "Sagittal", across: 2, axes: [0, 1], signs: [1, 1], sides: "APSI" },
  ]);
  expect(sliceViews(sagittal, false).map(({ onward }) => onward)).toEqual([-1, 1, -1]);
});

test("other slices have the world's axes at their sides, the third and the second upwards", () => {
  expect(named(sliceViews(EVEN, false))).toEqual([
    { name: "Perpendicular to z", across: 2, axes: [0, 1], signs: [1, -1], sides: "−x+x+y−y" },
    { name: "Perpendicular to y", across: 1, axes: [0, 2], signs: [1, -1], sides: "−x+x+z−z" },
    { name: "Perpendicular to x", across: 0, axes: [1, 2], signs: [1, -1], sides: "−y+y+z−z" },
  ]);
  // Who is on which side is a matter of patients alone.
  expect(sliceViews(EVEN, true)).toEqual(sliceViews(EVEN, false));
});

test("slices have true proportions, of uneven and of oblique axes too", () => {
  const [axial] = sliceViews(EVEN, false);
  expect(axial?.bounds).toEqual([-0.5, -9, 3.5, 1]);
  for (const grid of [EVEN, UNEVEN, SHEARED]) {
    for (const view of sliceViews(grid, false)) {
      const index = (i: number, j: number) => [0, 1, 2].map((axis) => (axis === view.axes[0] ? i : axis === view.axes[1] ? j : 1)) as unknown as [number, number, number];
      const apart = (a: readonly number[], b: readonly number[]) => Math.hypot(...a.map((n, axis) => n - (b[axis] ?? 0)));
      for (const [a, b] of [[[0, 0], [2, 1]], [[1.5, 0], [0.25, 2]], [[0, 1], [2, 1]]] satisfies [[number, number], [number, number]][]) {
        expect(apart(screenOf(view, ...a), screenOf(view, ...b)), view.name).toBeCloseTo(apart(worldOf(grid, index(...a)), worldOf(grid, index(...b))), 9);
        near(indicesAt(view, ...screenOf(view, ...a)), a);
      }
      const fit = fitInto(view, 300, 200, 10);
      near(indicesAtPixel(view, fit, ...pixelOf(view, fit, 1, 2)), [1, 2]);
      // All of it is in sight, and touches two of the margins.
      const corners = [[-0.5, -0.5], [-0.5, grid.dims[view.axes[1]] - 0.5], [grid.dims[view.axes[0]] - 0.5, -0.5], [grid.dims[view.axes[0]] - 0.5, grid.dims[view.axes[1]] - 0.5]].map(([i = 0, j = 0]) => pixelOf(view, fit, i, j));
      const [xs, ys] = [corners.map(([x]) => x), corners.map(([, y]) => y)];
      const slack = [Math.min(...xs) - 10, 290 - Math.max(...xs), Math.min(...ys) - 10, 190 - Math.max(...ys)];
      expect(Math.min(...slack)).toBeCloseTo(0, 6);
    }
  }
  expect(sliceViews(SHEARED, false).find(({ name }) => name === "Sagittal")?.skew[0]).not.toBe(0);
});

/** Pixels of a slice as rows of greys; `.` is transparent. */
function painted(view: SliceView, samples: readonly number[], size: readonly [number, number], width: number, height: number, window: readonly [number, number], isSmooth: boolean): (number | ".")[][] {
  const painting = { width, height, pixels: new Uint8ClampedArray(4 * width * height) };
  paintSlice(painting, view, { samples: Float32Array.from(samples), size }, fitInto(view, width, height, 0), window, isSmooth);
  return Array.from({ length: height }, (_, row) => Array.from({ length: width }, (__, column) => (painting.pixels[4 * (row * width + column) + 3] === 0 ? "." : (painting.pixels[4 * (row * width + column)] ?? 0))));
}

test("a pixel has the grey of its sample, the right way up, and none where that is missing", () => {
  const grid: Grid = { ...EVEN, dims: [3, 2, 1], spacing: [1, 1, 1] };
  const samples = [0, 1, 2, 3, NaN, 9];
  const [axial] = sliceViews(grid, false);
  if (axial === undefined) throw new Error("no slice");
  // y upwards: the second row is at the top.
  expect(painted(axial, samples, [3, 2], 3, 2, [0, 5], false)).toEqual([[153, ".", 255], [0, 51, 102]]);
  expect(painted(axial, samples, [3, 2], 3, 4, [0, 5], false)[0]).toEqual([".", ".", "."]);
  // Between samples it is interpolated, except beside a missing sample.
  expect(painted(axial, samples, [3, 2], 6, 4, [0, 5], true)[3]).toEqual([0, 13, 38, 64, 89, 102]);
  expect(painted(axial, samples, [3, 2], 6, 4, [0, 5], true)[0]).toEqual([153, 153, ".", ".", 255, 255]);
  // Window and level the other way round are the negative.
  expect(painted(axial, samples, [3, 2], 3, 2, [5, 0], false)[1]).toEqual([255, 204, 153]);
  // A slice whose axes are exchanged on screen, as of a sagittal series: samples are found all the same.
  const turned = sliceViews({ ...grid, direction: [[0, 1, 0], [1, 0, 0], [0, 0, 1]] }, false)[0];
  if (turned === undefined) throw new Error("no slice");
  expect([turned.axes, stridesOf(turned, [3, 2])]).toEqual([[1, 0], [3, 1]]);
  expect(painted(turned, samples, [3, 2], 2, 3, [0, 5], false)).toEqual([[102, 255], [51, "."], [0, 153]]);
  expect(sampleAt(turned, { samples: Float32Array.from(samples), size: [3, 2] }, 1, 2)).toBe(9);
});

test("an uneven axis takes as much space as its samples are apart", () => {
  const grid: Grid = { ...EVEN, dims: [3, 1, 1], spacing: [2, 1, 1], positions: [[0, 1, 4], null, null] };
  const view = sliceViews(grid, false)[0];
  if (view === undefined) throw new Error("no slice");
  // From −1 to 5, as the samples at the ends are half of a mean step wide: half a unit a pixel.
  expect(view.bounds.filter((_, i) => i % 2 === 0)).toEqual([-1, 5]);
  const row = painted(view, [1, 2, 3], [3, 1], 12, 2, [0, 3], false)[0];
  expect(row).toEqual([85, 85, 85, 170, 170, 170, 170, 255, 255, 255, 255, 255].map((grey) => grey));
});

test("contours are where edges are crossed, as the server's are", () => {
  const segments = (rows: readonly (readonly number[])[], iso: number) => {
    const found = contourOf(rows.flat(), [rows[0]?.length ?? 0, rows.length], iso) ?? [];
    // In which direction a segment runs does not matter.
    return Array.from({ length: found.length / 4 }, (_, i) => [[found[4 * i]!, found[4 * i + 1]!], [found[4 * i + 2]!, found[4 * i + 3]!]].sort(([a = 0, b = 0], [c = 0, d = 0]) => a - c || b - d).flat());
  };
  expect(segments([[0, 4], [0, 4]], 1)).toEqual([[0.25, 0, 0.25, 1]]);
  expect(segments([[0, 0], [0, 2]], 1)).toEqual([[0.5, 1, 1, 0.5]]);
  // Inside is at least the isovalue: a plateau at it is inside.
  expect(segments([[1, 1], [1, 1]], 1)).toEqual([]);
  expect(segments([[1, 0], [1, 0]], 1)).toEqual([[0, 0, 0, 1]]);
  // Two opposite corners are separated.
  expect(segments([[2, 0], [0, 2]], 1)).toEqual([[0, 0.5, 0.5, 0], [0.5, 1, 1, 0.5]]);
  // Beside a missing sample there is none.
  expect(segments([[0, 4, 4], [0, 4, NaN]], 1)).toEqual([[0.25, 0, 0.25, 1]]);
  expect(segments([[0, NaN], [0, 4]], 1)).toEqual([]);
  // A ring around a peak is closed: each end is that of two segments.
  const peak = [[0, 0, 0], [0, 5, 0], [0, 0, 0]];
  const ends = segments(peak, 1).flatMap(([a, b, c, d]) => [`${a},${b}`, `${c},${d}`]);
  expect([ends.length, new Set(ends).size]).toEqual([8, 4]);
  // Noise has no outline that could be drawn.
  expect(contourOf(Float32Array.from({ length: 400 * 400 }, (_, i) => (i + Math.floor(i / 400)) % 2), [400, 400], 0.5)).toBeUndefined();
  expect([...maskedBy(Float32Array.from([1, 2, 3]), [7, 8, 7], (value) => value === 7)]).toEqual([1, NaN, 3]);
});

test("an outline is where the mask holds, whichever way it compares", () => {
  // A step at 0.5 in each of five rows, which the mask's field numbers.
  const of = (samples: readonly number[]): Plane => ({ ...plane(), samples: Float32Array.from(samples), size: [2, 5] });
  const planes = new Map([["depth", of([0, 1, 0, 1, 0, 1, 0, 1, 0, 1])], ["labels", of([1, 1, 2, 2, 3, 3, 4, 4, 5, NaN])]]);
  const rows = (mask: string | null, labels: readonly { readonly value: number; readonly stored?: string; readonly name: null; readonly color: null }[] = []) => {
    const [outline] = outlinesOf([{ number: 0, view: { ...OPENING, iso: 0.5, mask }, style: DEFAULT_STYLE }]);
    const info = { ...volume.fields[0]!, name: "labels", labels: [...labels] };
    const found = outlineIn({ index: 0, planes }, outline!, [info]) ?? [];
    return Array.from({ length: found.length / 4 }, (_, i) => Math.min(found[4 * i + 1]!, found[4 * i + 3]!));
  };
  expect(rows(null)).toEqual([0, 1, 2, 3]);
  expect([rows("labels==1,3..4"), rows("labels!=1"), rows("labels>=3"), rows("labels<=2"), rows("labels>1"), rows("labels<3")]).toEqual([[2], [1, 2], [2], [0], [1, 2], [0]]);
  // Labels by the numbers in their file.
  expect(rows("labels==16777217..16777219", [1, 2, 3].map((value) => ({ value, stored: String(16777216 + value), name: null, color: null })))).toEqual([0, 1]);
  // Its samples are not there yet.
  expect(rows("other==1")).toEqual([]);
});

test("a drag with the right button changes window and level, by shares of what they are", () => {
  expect(draggedWindow([0, 100], 0, 0, 1000)).toEqual([0, 100]);
  expect(draggedWindow([0, 100], 120, 0, 1000)).toEqual([-50, 150]);
  expect(draggedWindow([0, 100], 0, -120, 1000)).toEqual([-50, 50]);
  const [black, white] = draggedWindow([0, 100], -1e5, 0, 1000);
  expect(white - black).toBeCloseTo(1e-3);
  expect(draggedWindow([5, 5], 0, 0, 2)).toEqual([4, 6]);
});

test("the wheel goes on by whole slices", () => {
  const wheel = new WheelSteps();
  // Notches of a mouse, and lines of Firefox.
  expect([-120, 120, 100, -400].map((deltaY) => wheel.take({ deltaY, deltaMode: 0 }))).toEqual([1, -1, -1, 3]);
  expect(wheel.take({ deltaY: -3, deltaMode: 1 })).toBe(1);
  // A touchpad, and turned round.
  expect([-15, -15, -15, 10, 10, 10, 10].map((deltaY) => wheel.take({ deltaY, deltaMode: 0 }) + 0)).toEqual([0, 0, 1, 0, 0, 0, -1]);
});

const DIMS = [4, 5, 6] as const;

test("the crosshair is at a sample, begins in the middle and stays inside", () => {
  expect(crosshairOf(FIRST_SLICING, DIMS)).toEqual([2, 2, 3]);
  const there = pointed(FIRST_SLICING, DIMS, [1.4, -3, 99]);
  expect(there.at).toEqual([1, 0, 5]);
  expect(pointed(there, DIMS, [1, 0, 5])).toBe(there);
  expect(moved(there, DIMS, 0, 1).at).toEqual([2, 0, 5]);
  expect(moved(there, DIMS, 2, 10)).toBe(there);
  expect((["picture", "both", "slices"] as const).map((layout) => nextLayout({ ...FIRST_SLICING, layout }))).toEqual(["both", "slices", "picture"]);
  // Slices in the picture follow it while it is shown.
  const planes = [3, null, 0] as const;
  expect(planesAt(planes, there, DIMS)).toBe(planes);
  expect(planesAt(planes, { ...there, layout: "both" }, DIMS)).toEqual([1, null, 5]);
});

test("in the picture the crosshair's lines go through the whole volume", () => {
  const { at, ends } = crosshairPlace(EVEN, [1, 2, 3]);
  expect(at).toEqual([11, 24, 39]);
  expect(ends).toEqual([[[10, 24, 39], [13, 24, 39]], [[11, 20, 39], [11, 28, 39]], [[11, 24, 30], [11, 24, 45]]]);
});

test("outlines are of surfaces that are shown, and need their fields and masks", () => {
  const surface = (number: number, of: object, style = {}) => ({ number, view: { ...OPENING, ...of }, style: { ...DEFAULT_STYLE, ...style } });
  const surfaces = [surface(0, { iso: 1 }), surface(1, { field: "height", mask: "labels==1,4..7" }, { color: "#ff0000" }), surface(2, { field: "other" }, { visible: false })];
  expect(outlinesOf(surfaces)).toEqual([
    { surface: 0, field: "depth", iso: 1, mask: undefined, color: undefined },
    { surface: 1, field: "height", iso: 0, mask: { field: "labels", comparison: "==", values: "1,4..7" }, color: "#ff0000" },
  ]);
  expect(fieldsOf(FIRST_SLICING, "depth", surfaces)).toEqual(["depth", "height", "labels"]);
  expect(fieldsOf({ ...FIRST_SLICING, field: "t1" }, "depth", surfaces)).toEqual(["t1", "depth", "height", "labels"]);
});

test("a link holds layout and crosshair; one of before says nothing of them", () => {
  const state = { volume: "ball", step: 0, surfaces: [{ number: 0, view: OPENING, style: DEFAULT_STYLE }], selected: 0, opening: OPENING, look: DEFAULT_LOOK, openingLook: DEFAULT_LOOK, pose: undefined };
  const slicing: Slicing = { layout: "both", at: [3, 4, 5], field: "height", leftIsLeft: true };
  expect(encodeLink({ ...state, slicing })).toContain("layout=both&crosshair=3,4,5&slicefield=height&left=left");
  expect(decodeLink(encodeLink({ ...state, slicing }))?.slicing).toEqual(slicing);
  expect(decodeLink(encodeLink({ ...state, slicing: { ...FIRST_SLICING, layout: "slices" } }))?.slicing).toEqual({ ...FIRST_SLICING, layout: "slices" });
  expect(encodeLink({ ...state, slicing: { ...slicing, layout: "picture" } })).toBe(`${encodeLink(state)}&slicefield=height`);
  expect(decodeLink(encodeLink(state))?.slicing).toBeUndefined();
  expect(() => decodeLink("volume=ball&layout=four")).toThrow("“layout” is \"four\", expected one of picture, both, slices");
  expect(() => decodeLink("volume=ball&layout=both&crosshair=1,2")).toThrow("“crosshair” has 2 numbers, expected 3");
  expect(() => decodeLink("volume=ball&layout=both&left=up")).toThrow("expected left or right");
});


test("each volume keeps its crosshair, and slices in the picture stay where it was", () => {
  const store = new ActingStore();
  const open = (one: typeof volume, wish?: Parameters<ActingStore["open"]>[1]) => {
    store.leave(undefined);
    store.open({ type: "opened", volume: one, step: 0, edit: OPENING, device: "", capabilities: {} } as never, wish);
  };
  open(volume);
  store.changeLook({ slices: { planes: [1, null, null] } });
  store.changePage({ slicing: { ...FIRST_SLICING, layout: "both", at: [7, 8, 9], field: "height" } });
  open(other);
  expect(store.page.slicing).toEqual({ ...FIRST_SLICING, layout: "both" });
  open(volume);
  expect(store.page.slicing).toEqual({ ...FIRST_SLICING, layout: "both", at: [7, 8, 9] });
  expect(store.look.slices.planes).toEqual([1, null, null]);
  // A link without slices does not change the work on the volume before.
  open(other, { surfaces: [{ edit: {}, style: {} }], selected: 0, look: {}, pose: undefined });
  expect(store.page.slicing).toEqual(FIRST_SLICING);
  open(volume);
  expect(store.look.slices.planes).toEqual([1, null, null]);
  // Nor does what the one in control shows.
  store.changePage({ slicing: { ...store.page.slicing, layout: "both" } });
  store.dispatch({ type: "adopt", work: store.work, slicing: FIRST_SLICING });
  expect([store.page.slicing, store.look.slices.planes]).toEqual([FIRST_SLICING, [1, null, null]]);
  store.changePage({ slicing: { ...FIRST_SLICING, layout: "both", at: [7, 8, 9] } });
  store.changePage({ slicing: { ...store.page.slicing, layout: "picture" } });
  expect(store.look.slices.planes).toEqual([7, null, null]);
  // Another link has another layout.
  store.replace({ surfaces: [{ edit: {}, style: {} }], selected: 0, look: {}, slicing: { ...FIRST_SLICING, layout: "slices" } });
  expect(store.page.slicing.layout).toBe("slices");
  store.replace({ surfaces: [{ edit: {}, style: {} }], selected: 0, look: {} });
  expect(store.page.slicing).toEqual(FIRST_SLICING);
});

test("what is said of a sample is exact", () => {
  expect(positionWords(EVEN, [1, 2, 3], "mm")).toBe("11.0, 24.0, 39.0 mm");
  expect(positionWords({ ...EVEN, spacing: [0.25, 1, 1], origin: [-0.25, -1, 0] }, [1, 0, 0], undefined)).toBe("0.00, −1.00, 0.00");
  const [field] = volume.fields;
  if (field === undefined) throw new Error("a field expected");
  expect([valueWords(-1024, field), valueWords(Math.fround(0.1), field), valueWords(Math.fround(16.000002), field), valueWords(NaN, field), valueWords(3, undefined)]).toEqual(["-1024 mm", "0.1 mm", "16.000002 mm", "no value", "3"]);
  const labels = [{ value: 3, name: "putamen", color: null }, { value: 4, stored: "16777217", name: null, color: null }];
  expect([3, 4, 5].map((value) => valueWords(value, { ...field, unit: null, labels }))).toEqual(["3 · putamen", "16777217", "5"]);
  expect(problemWords([undefined, "busy"], false, "connected", true)).toBe("The slices cannot be shown: busy. What is marked as old is from before");
  expect(problemWords([undefined], false, "waiting", false)).toBe("No connection to the server: there are no new slices");
  expect([problemWords([undefined], false, "connected", true), problemWords([undefined], true, "waiting", true)]).toEqual(["", ""]);
});

/** Planes whose requests are answered by hand. */
function planesByHand() {
  const asked: { readonly request: PlaneRequest; readonly signal: AbortSignal; readonly answer: (plane: Plane | Error) => void }[] = [];
  let shown: readonly SliceState[] = [];
  let times = 0;
  const planes = new SlicePlanes((slices) => ([shown, times] = [slices, times + 1]), new URL("http://server/"), (_, request, signal) =>
    new Promise((found, failed) => {
      asked.push({ request, signal, answer: (plane) => (plane instanceof Error ? failed(plane) : found(plane)) });
      signal.addEventListener("abort", () => failed(new Error("aborted")));
    }));
  const settle = (ms = 45) => new Promise((done) => setTimeout(done, ms));
  const wanted = (z: number, fields: readonly string[] = ["depth"], of = volume): SlicesWanted => ({ volume: of!, step: 0, fields, at: [1, 2, z] });
  return { planes, asked, settle, wanted, shown: () => shown, times: () => times, last: (axis: string) => asked.filter(({ request }) => request.axis === axis) };
}

const plane = (): Plane => ({ samples: new Float32Array(1), size: [1, 1], origin: [0, 0, 0], right: [1, 0, 0], down: [0, 1, 0] });

test("one request an axis is on its way, and the last place of the crosshair is shown", async () => {
  const { planes, asked, settle, wanted, shown, last } = planesByHand();
  for (const z of [3, 4, 5, 6]) planes.show(wanted(z), true);
  expect(asked.map(({ request: { axis, index } }) => `${axis}${index}`)).toEqual(["x1", "y2", "z3"]);
  for (const { answer } of asked) answer(plane());
  await settle();
  // What has come is shown on the way, and said to be old.
  expect(shown().map(({ loaded, isCurrent }) => [loaded?.index, isCurrent])).toEqual([[1, true], [2, true], [3, false]]);
  expect(last("z").map(({ request }) => request.index)).toEqual([3, 6]);
  asked.at(-1)?.answer(plane());
  await settle();
  expect(shown().every(({ isCurrent }) => isCurrent)).toBe(true);
  // A slice of before is kept.
  planes.show(wanted(3), true);
  expect([asked.length, shown()[2]?.loaded?.index, shown()[2]?.isCurrent]).toEqual([4, 3, true]);
});

test("what changes nothing tells nothing", async () => {
  const { planes, asked, settle, wanted, times } = planesByHand();
  planes.show(wanted(3), true);
  for (const { answer } of asked) answer(plane());
  await settle();
  const before = times();
  for (let i = 0; i < 5; i += 1) planes.show(wanted(3), true);
  expect([times(), asked.length]).toEqual([before, 3]);
});

test("a request that nobody waits for is aborted: at once of another field or volume, after a while of another slice", async () => {
  const { planes, asked, settle, wanted, shown, last } = planesByHand();
  planes.show(wanted(3), true);
  planes.show(wanted(4), true);
  expect(last("z")[0]?.signal.aborted).toBe(false);
  await settle(560);
  expect(last("z").map(({ request, signal }) => [request.index, signal.aborted])).toEqual([[3, true], [4, false]]);
  planes.show(wanted(4, ["height"]), true);
  expect(asked.slice(0, 4).map(({ signal }) => signal.aborted)).toEqual([true, true, true, true]);
  await settle();
  expect(last("z").at(-1)?.request.field).toBe("height");
  for (const { answer } of asked) answer(plane());
  await settle();
  expect(shown()[2]?.loaded?.planes.has("height")).toBe(true);
  planes.show(wanted(4, ["depth"], other), true);
  expect(shown().map(({ loaded }) => loaded)).toEqual([undefined, undefined, undefined]);
  await settle();
  planes.show(undefined, true);
  expect(asked.slice(-3).every(({ signal }) => signal.aborted)).toBe(true);
});

test("fields are asked for one after the other, and all of them are shown together", async () => {
  const { planes, asked, settle, wanted, shown, last } = planesByHand();
  planes.show(wanted(3, ["depth", "height"]), true);
  for (const { answer } of asked.slice(0, 3)) answer(plane());
  await settle();
  expect(last("z").map(({ request }) => request.field)).toEqual(["depth", "height"]);
  expect(shown()[2]?.loaded).toBeUndefined();
  for (const { answer } of asked.slice(3)) answer(plane());
  await settle();
  expect([...(shown()[2]?.loaded?.planes.keys() ?? [])]).toEqual(["depth", "height"]);
});

test("a server that refuses is asked twice, then it is said, and the last slice stays as an old one", async () => {
  const { planes, asked, settle, wanted, shown, last } = planesByHand();
  planes.show(wanted(3), true);
  for (const { answer } of asked) answer(plane());
  await settle();
  planes.show(wanted(4), true);
  last("z").at(-1)?.answer(new Error("busy"));
  await settle(560);
  expect([last("z").length, shown()[2]?.problem]).toEqual([3, undefined]);
  last("z").at(-1)?.answer(new Error("busy"));
  await settle(560);
  expect([last("z").length, shown()[2]?.problem, shown()[2]?.loaded?.index, shown()[2]?.isCurrent]).toEqual([3, "busy", 3, false]);
  planes.retry();
  expect([last("z").length, shown()[2]?.problem]).toEqual([4, undefined]);
  // A line that was cut without a word: the next connection asks again.
  planes.show(wanted(4), false);
  planes.show(wanted(4), true);
  await settle();
  expect(last("z").map(({ signal }) => signal.aborted).slice(-2)).toEqual([true, false]);
  last("z").at(-1)?.answer(plane());
  await settle();
  expect(shown()[2]).toMatchObject({ isCurrent: true, problem: undefined });
});
