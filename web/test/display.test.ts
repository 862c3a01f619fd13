import { expect, test } from "vitest";
import type { SurfaceRenderer } from "../src/scene/renderer";
import { DEFAULT_LOOK, type Look } from "../src/state/look";
import { DEFAULT_STYLE } from "../src/state/surfaceList";
import { colorBarOf, Display } from "../src/wiring/display";
import { OPENING, VOLUMES } from "./fixture";

const SURFACES = [{ number: 0, view: OPENING, style: DEFAULT_STYLE }];
const DISTANCES = { share: 0.98, upper: 0.3, farthest: 1.2 };

/** A display over a scene that notes the colours it is asked for. */
function displayOf() {
  const modes: string[] = [];
  const ranges: number[] = [];
  const titles: (string | undefined)[] = [];
  const scales: (readonly [number, number])[] = [];
  const scene = {
    camera: { projection: "perspective" },
    annotations: { show: () => undefined, showColors: (bar?: { title: string }) => titles.push(bar?.title) },
    setLook: ({ colorMode }: { colorMode: string }) => modes.push(colorMode),
    setFinestLevel: () => undefined,
    setClip: () => undefined,
    setSlices: () => undefined,
    setSurfaceStyle: () => undefined,
    colors: {
      setAlpha: () => undefined,
      setTransfer: () => undefined,
      setField: ({ range }: { range: readonly [number, number] }) => scales.push(range),
      setValueColors: (_low: number, high: number) => ranges.push(high),
    },
  };
  const display = new Display(scene as unknown as SurfaceRenderer, new URL("http://127.0.0.1/"), () => undefined);
  const source = { volume: VOLUMES[0]!, step: 0, field: "depth" };
  const show = (look: Look, distances?: typeof DISTANCES) => display.show(look, SURFACES, 0, source, { distances, known: new Map() });
  /** @param shown the field whose values the vertices on screen have */
  const showField = (colorField: string | null, shown: string | null, colorBy: Look["colorBy"] = "field") =>
    display.show({ ...DEFAULT_LOOK, colorBy }, [{ ...SURFACES[0]!, view: { ...OPENING, colorField } }], 0, source, { distances: undefined, known: new Map([[0, { shownField: shown }]]) });
  return { show, showField, modes, ranges, titles, scales };
}

test("colours of the error come when it is measured, and the former ones come back until it is measured again", () => {
  const { show, modes, ranges, titles } = displayOf();
  show({ ...DEFAULT_LOOK, colorBy: "level" });
  const error: Look = { ...DEFAULT_LOOK, colorBy: "error" };
  show(error);
  show(error);
  expect(modes).toEqual(["level", "level"]);
  show(error, DISTANCES);
  expect([modes.at(-1), ranges, titles.at(-1)]).toEqual(["value", [0.3], "Off by, in world units"]);
  show(error);
  expect([modes.at(-1), titles.at(-1)]).toEqual(["level", undefined]);
  show(error, { ...DISTANCES, upper: 0.5 });
  expect([modes.at(-1), ranges]).toEqual(["value", [0.3, 0.5]]);
  // What is as before costs no frame.
  const count = modes.length;
  show(error, { ...DISTANCES, upper: 0.5 });
  expect(modes.length).toBe(count);
});

test("colours of a field come with the values of the field", () => {
  const { showField, modes, scales } = displayOf();
  const [first, second] = VOLUMES[0]!.fields.map(({ name, range }) => ({ name, range }));
  if (first === undefined || second === undefined) throw new Error("expected a volume with two fields");
  showField(null, null, "level");
  showField(first.name, null);
  expect([modes.at(-1), scales]).toEqual(["level", []]);
  showField(first.name, first.name);
  expect([modes.at(-1), scales]).toEqual(["field", [first.range]]);
  // The values of the first field keep its scale until those of the second have come.
  showField(second.name, first.name);
  expect([modes.at(-1), scales]).toEqual(["field", [first.range]]);
  showField(second.name, second.name);
  expect(scales).toEqual([first.range, second.range]);
});

test("the bar of the error names its ends", () => {
  const look: Look = { ...DEFAULT_LOOK, colorBy: "error" };
  expect(colorBarOf(look, undefined, undefined, undefined)).toBeUndefined();
  expect(colorBarOf(look, undefined, DISTANCES, undefined)).toMatchObject({ texts: ["0", "0.15", "≥ 0.3"], title: "Off by, in world units" });
  expect(colorBarOf(look, undefined, DISTANCES, "mm")?.title).toBe("Off by, in mm");
});

test("the bar of the field that matters has its units, from end to end of its range", () => {
  const look: Look = { ...DEFAULT_LOOK, colorBy: "field", map: "ylor" };
  const view = { ...OPENING, feature: "depth", featureRange: [-10, 30] as const };
  expect(colorBarOf(look, view, undefined, undefined, VOLUMES[0])).toMatchObject({ texts: ["-10", "10", "30"], title: "depth, in mm" });
  expect(colorBarOf(look, { ...view, feature: "none" }, undefined, undefined, VOLUMES[0])).toBeUndefined();
});
