/** A surface in a link: names and values. Pure. */

import { MAX_POINTS } from "../protocol/generated";
import type { Edit, TransferFunction, View } from "../protocol/types";
import { LinkError, toNumber, toNumbers, type Reader } from "./linkReader";
import { digits, list } from "./numbers";
import { partsText, readParts } from "./parts";
import type { Wish } from "./state";
import { DEFAULT_STYLE, type Surface, type SurfaceStyle } from "./surfaceList";
import { difference } from "../protocol/view";

type Part = readonly [string, string | undefined];

/** Only what differs from how the volume opens. */
export function surfaceParts({ view, style }: Surface, opening: View): readonly Part[] {
  const { visible, opacity, color } = style;
  return [
    // Always: another step opens with another isovalue.
    ["iso", digits(view.iso)],
    ...editParts(difference(opening, view), view),
    ["tint", color?.slice(1)],
    ["opacity", opacity === DEFAULT_STYLE.opacity ? undefined : digits(opacity)],
    ["hidden", visible ? undefined : "1"],
  ];
}

function editParts(edit: Edit, view: View): readonly Part[] {
  const { triangles } = edit;
  const share = typeof triangles === "object" ? triangles : undefined;
  const range = edit.feature === undefined || edit.feature === "none" ? edit.featureRange : view.featureRange;
  const number = (value: number | null | undefined) => (value === undefined || value === null ? undefined : digits(value));
  const distance = (value: number | string | undefined) => (typeof value === "number" ? digits(value) : value);
  return [
    ["field", edit.field],
    ["mask", edit.mask ?? undefined],
    ["feature", edit.feature],
    // Always that of another feature, though it be the same.
    ["range", range && list(range)],
    ["colorField", edit.colorField ?? undefined],
    ["alpha", number(edit.alpha)],
    ["beta", number(edit.beta)],
    ["error", distance(edit.error)],
    ["triangles", typeof triangles === "number" ? String(triangles) : undefined],
    ["share", number(share?.share)],
    ["max", number(share?.max)],
    ["bytes", number(edit.bytes)],
    ["minPart", number(edit.minPart)],
    ["parts", edit.parts === undefined ? undefined : partsText(edit.parts)],
    ["maxError", edit.maxError === null ? "none" : distance(edit.maxError)],
    ["topology", edit.topology],
    ["mesher", edit.mesher],
    ["detail", edit.detail],
    ["maxLevel", number(edit.maxLevel)],
    ["tf", edit.transferFunction?.points.map((p) => `${list([p.x, p.importance])},${p.color.slice(1)}`).join(";")],
    ["roi", edit.interest?.map(interestText).join(";")],
  ];
}

function interestText({ sphere, box, importance }: View["interest"][number]): string {
  const numbers = sphere !== undefined ? [...sphere.center, sphere.radius] : [...(box?.min ?? []), ...(box?.max ?? [])];
  return list([...numbers, importance]);
}

/** @throws LinkError naming what was wrong */
export function readSurface(read: Reader): Wish["surfaces"][number] {
  return { edit: readEdit(read), style: readStyle(read) };
}

function readStyle(read: Reader): Partial<SurfaceStyle> {
  const [tint, opacity, hidden] = [read.text("tint"), read.number("opacity"), read.flag("hidden")];
  if (opacity !== undefined && !(opacity >= 0 && opacity <= 1)) throw new LinkError(`This link's “${read.named("opacity")}” is ${opacity}, expected a number from 0 to 1`);
  return {
    ...(tint === undefined ? {} : { color: colorOf(read.named("tint"), tint) }),
    ...(opacity === undefined ? {} : { opacity }),
    ...(hidden === undefined ? {} : { visible: !hidden }),
  };
}

function colorOf(name: string, text: string): string {
  if (!/^[0-9a-f]{6}$/i.test(text)) throw new LinkError(`This link's “${name}” has the colour ${JSON.stringify(text)}, expected six digits such as f57900`);
  return `#${text}`;
}

function readEdit(read: Reader): Edit {
  const share = read.number("share");
  const max = read.number("max");
  const triangles = share === undefined ? read.number("triangles") : { share, ...(max === undefined ? {} : { max }) };
  const maxError = read.distance("maxError");
  const points = read.list("tf", pointOf);
  const parts = read.text("parts");
  const found = {
    iso: read.number("iso"),
    field: read.text("field"),
    mask: read.text("mask"),
    feature: read.text("feature"),
    featureRange: read.numbers("range", 2),
    colorField: read.text("colorField"),
    alpha: read.number("alpha"),
    beta: read.number("beta"),
    error: read.distance("error"),
    triangles,
    bytes: read.number("bytes"),
    minPart: read.number("minPart"),
    parts: parts === undefined ? undefined : readParts(parts, read.named("parts")),
    maxError: maxError === "none" ? null : maxError,
    topology: read.text("topology") as View["topology"] | undefined,
    mesher: read.text("mesher") as View["mesher"] | undefined,
    detail: read.text("detail") as View["detail"] | undefined,
    maxLevel: read.number("maxLevel"),
    transferFunction: points === undefined || points.length === 0 ? undefined : ({ points: points.slice(0, MAX_POINTS) } satisfies TransferFunction),
    interest: read.list("roi", interestOf),
  };
  return Object.fromEntries(Object.entries(found).filter(([, value]) => value !== undefined));
}

function pointOf(text: string, name: string): TransferFunction["points"][number] {
  const [x = "", importance = "", color = ""] = text.split(",");
  return { x: toNumber(name, x), importance: toNumber(name, importance), color: colorOf(name, color) };
}

function interestOf(text: string, name: string): View["interest"][number] {
  const [a = 0, b = 0, c = 0, d = 0, ...rest] = toNumbers(name, text, [5, 7]);
  const [e = 0, f = 0, g] = rest;
  if (g === undefined) return { sphere: { center: [a, b, c], radius: d }, importance: e };
  return { box: { min: [a, b, c], max: [d, e, f] }, importance: g };
}
