/** The command that writes the mesh of a view. Pure. */

import type { Statistics, View, ViewCamera } from "../protocol/types";
import { followsCamera } from "../protocol/view";
import { placesOf, type Parts } from "./parts";

const quoted = (text: string) => (/^[\w./:,%+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
/** More than the 32 bits have that the server computes with. */
const digits = (n: number) => String(Number(n.toPrecision(9)));

/**
 * `isopeel extract …` in a POSIX shell. The page does not know the path of the volume's file: the volume's id stands in its place.
 * @param statistics of the surface in force: a share with a limit becomes a number of triangles
 * @param camera for which the surface is made, if the view follows cameras
 */
export function commandLine(volume: string, step: number, view: View, statistics: Statistics | undefined, camera?: ViewCamera): string {
  const options: (readonly (string | undefined)[])[] = [
    ["--iso", digits(view.iso)],
    ["--field", view.field],
    ["--step", step === 0 ? undefined : String(step)],
    ["--mask", view.mask ?? undefined],
    ...featureOptions(view),
    ["--field-values", view.colorField ?? undefined],
    ...criterionOptions(view, statistics),
    ...detailOptions(view, camera),
    ["--min-part", (view.minPart ?? 0) > 0 ? digits(view.minPart ?? 0) : undefined],
    ...placesOf(view.parts).map((place) => [partOption(view.parts), place.map(digits).join(",")]),
    ["--max-error", view.maxError === null ? "none" : String(view.maxError)],
    ["--topology", view.topology],
    ["--mesher", view.mesher],
    ["--max-level", String(view.maxLevel)],
    view.cap ? ["--cap"] : [],
    ...view.interest.map((region) => ["--interest", interestOption(region)]),
  ];
  const words = options.filter((words) => !words.includes(undefined)).flat().map((word) => quoted(word ?? ""));
  const transfer = `--transfer-function <(echo ${quoted(JSON.stringify(view.transferFunction))})`;
  return ["isopeel extract", quoted(volume), ...words, transfer, "-o", quoted(`${volume}.glb`)].join(" ");
}

function featureOptions({ feature, featureRange, alpha }: View): (readonly string[])[] {
  if (feature === "none") return [];
  const range = featureRange === undefined ? [] : [["--feature-range", ...featureRange.map(digits)]];
  return [["--feature", feature], ...range, ["--alpha", digits(alpha)]];
}

function criterionOptions({ beta, error, triangles, bytes }: View, statistics: Statistics | undefined): (readonly string[])[] {
  const options: string[][] = [];
  if (beta !== undefined) options.push(["--beta", digits(beta)]);
  if (error !== undefined) options.push(["--error", typeof error === "number" ? digits(error) : error]);
  if (bytes !== undefined) options.push(["--bytes", String(bytes)]);
  if (triangles !== undefined) options.push(["--triangles", budget(triangles, statistics)]);
  return options;
}

function detailOptions(view: View, camera: ViewCamera | undefined): (readonly string[])[] {
  if (view.detail === "uniform") return [["--detail", "uniform"]];
  if (camera === undefined || !followsCamera(view)) return [];
  const { position, target, up = [], fov, height, viewport } = camera;
  const lens = fov === undefined ? ["--view-height", digits(height ?? 1)] : ["--fov", digits(fov)];
  return [["--camera", [...position, ...target, ...up].map(digits).join(",")], ["--viewport", viewport.join("x")], lens];
}

/** The command line knows a number or a share. */
function budget(triangles: NonNullable<View["triangles"]>, statistics: Statistics | undefined): string {
  if (typeof triangles === "number") return String(triangles);
  const { share, max } = triangles;
  const limited = max !== undefined && statistics !== undefined && share * statistics.fullTriangles > max;
  return limited ? String(max) : `${digits(100 * share)}%`;
}

const partOption = (parts: Parts) => (parts !== null && "keep" in parts ? "--keep-part" : "--hide-part");

function interestOption({ sphere, box, importance }: View["interest"][number]): string {
  const at = (point: readonly number[]) => point.map(digits).join(",");
  const place = sphere !== undefined ? `sphere:${at(sphere.center)}:${digits(sphere.radius)}` : `box:${at(box?.min ?? [])}:${at(box?.max ?? [])}`;
  return `${place}=${digits(importance)}`;
}
