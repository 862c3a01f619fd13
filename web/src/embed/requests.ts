/** Requests of the embedding page, read and checked: docs/embedding.md. Pure. */

import type { Pose } from "../state/look";
import type { Vec3 } from "../protocol/types";

/** Of the messages in both directions. */
export const VERSION = 1;

const VIEWS = ["home", "fit", "+x", "-x", "+y", "-y", "+z", "-z"] as const;
/** Maximum length of a link: the server's limit for one message. */
const LONGEST_LINK = 64 << 10;
const LONGEST_CAPTION = 300;
/** The server's own are 62 characters; one of a file may be longer. */
const LONGEST_TOKEN = 1024;

/** Options of an image, as in the page's own card. */
interface ImageRequest {
  readonly scale: number;
  readonly transparent: boolean;
  readonly colorBar: boolean;
  readonly isovalues: boolean;
  readonly scaleBar: boolean;
  readonly caption: string;
}

export type HostRequest =
  | { readonly type: "get" }
  /** A whole state, as a link has it behind `#`. */
  | { readonly type: "set"; readonly link: string }
  /** Some names of a link; `null`: as the volume opens. */
  | { readonly type: "change"; readonly values: ReadonlyMap<string, string | null> }
  /** Moves the camera to a pose or view, if there is one; the answer is the camera's pose. */
  | { readonly type: "camera"; readonly to: Pose | (typeof VIEWS)[number] | undefined }
  | { readonly type: "image"; readonly image: ImageRequest }
  /** A token to be used for the server from now on. */
  | { readonly type: "token"; readonly token: string };

/** Id of a request. The answer repeats it, so that the embedding page can match the two. */
export type RequestId = string | number;

/** An invalid request; the message is for the authors of the embedding page. */
export class RequestError extends Error {
  override readonly name = "RequestError";
}

type Fields = Readonly<Record<string, unknown>>;

/** Whether a message is meant for isopeel: others may be sent to the same window. */
export function isForIsopeel(data: unknown): data is Fields {
  return typeof data === "object" && data !== null && Object.hasOwn(data, "isopeel");
}

/** The request's id; `undefined` if it has none that can be returned. */
export function idOf({ id }: Fields): RequestId | undefined {
  return typeof id === "string" || typeof id === "number" ? id : undefined;
}

/** @throws RequestError naming what was wrong and what was expected */
export function readRequest(data: Fields): HostRequest {
  const { isopeel, id: _, type, ...fields } = data;
  if (isopeel !== VERSION) throw new RequestError(`isopeel is ${said(isopeel)}, expected ${VERSION}, the version of these messages`);
  if (idOf(data) === undefined) throw new RequestError(`id is ${said(data["id"])}, expected a number or a text, which the answer repeats`);
  if (typeof type !== "string" || !Object.hasOwn(READERS, type)) {
    throw new RequestError(`type is ${said(type)}, expected one of ${Object.keys(READERS).join(", ")}`);
  }
  const { names, read } = READERS[type as HostRequest["type"]];
  const stray = Object.keys(fields).find((name) => !names.includes(name));
  if (stray !== undefined) throw new RequestError(`${type} has no field ${said(stray)}. It has: ${names.join(", ") || "none"}`);
  return read(fields);
}

const READERS: Readonly<Record<HostRequest["type"], { readonly names: readonly string[]; readonly read: (fields: Fields) => HostRequest }>> = {
  get: { names: [], read: () => ({ type: "get" }) },
  set: { names: ["link"], read: ({ link }) => ({ type: "set", link: text("link", link, LONGEST_LINK).replace(/^[^#]*#/, "") }) },
  change: { names: ["values"], read: ({ values }) => ({ type: "change", values: readValues(values) }) },
  camera: { names: ["position", "target", "view"], read: readCamera },
  image: { names: ["scale", "transparent", "colorBar", "scaleBar", "isovalues", "caption"], read: readImage },
  token: { names: ["token"], read: readToken },
};

function readValues(values: unknown): ReadonlyMap<string, string | null> {
  if (typeof values !== "object" || values === null || Array.isArray(values)) throw new RequestError(`values is ${said(values)}, expected an object`);
  return new Map(
    Object.entries(values).map(([name, value]) => {
      if (value === null) return [name, null];
      if (typeof value === "number" && Number.isFinite(value)) return [name, String(value)];
      if (typeof value !== "string") throw new RequestError(`values.${name} is ${said(value)}, expected a number, a text or null`);
      return [name, text(`values.${name}`, value, LONGEST_LINK)];
    }),
  );
}

function readCamera({ position, target, view }: Fields): HostRequest {
  if (view !== undefined) {
    const found = VIEWS.find((one) => one === view);
    if (found === undefined) throw new RequestError(`view is ${said(view)}, expected one of ${VIEWS.join(", ")}`);
    if (position !== undefined || target !== undefined) throw new RequestError("camera has a view beside position or target, expected one of both");
    return { type: "camera", to: found };
  }
  if (position === undefined && target === undefined) return { type: "camera", to: undefined };
  const [from, at] = [point("position", position), point("target", target)];
  if (from.every((n, axis) => n === at[axis])) throw new RequestError("position and target are the same place: there is no direction to look in");
  return { type: "camera", to: { position: from, target: at } };
}

function point(name: string, value: unknown): Vec3 {
  const isPoint = Array.isArray(value) && value.length === 3 && value.every((n) => typeof n === "number" && Number.isFinite(n));
  if (!isPoint) throw new RequestError(`${name} is ${said(value)}, expected three numbers`);
  return value as unknown as Vec3;
}

function readImage({ scale = 1, transparent = false, colorBar = true, scaleBar = true, isovalues = true, caption = "" }: Fields): HostRequest {
  if (typeof scale !== "number" || !(scale >= 1 && scale <= 4)) throw new RequestError(`scale is ${said(scale)}, expected a number, 1 to 4`);
  const isOn = (name: string, value: unknown) => {
    if (typeof value !== "boolean") throw new RequestError(`${name} is ${said(value)}, expected true or false`);
    return value;
  };
  return {
    type: "image",
    image: {
      scale,
      transparent: isOn("transparent", transparent),
      colorBar: isOn("colorBar", colorBar),
      isovalues: isOn("isovalues", isovalues),
      scaleBar: isOn("scaleBar", scaleBar),
      caption: text("caption", caption, LONGEST_CAPTION),
    },
  };
}

/** An error does not repeat the value, which may be most of a token. */
function readToken({ token }: Fields): HostRequest {
  if (typeof token !== "string" || token.length > LONGEST_TOKEN || !/^[\x21-\x7e]+$/.test(token)) {
    throw new RequestError("token is none, expected the text that POST /api/v1/embed-tokens has answered with");
  }
  return { type: "token", token };
}

function text(name: string, value: unknown, longest: number): string {
  if (typeof value !== "string") throw new RequestError(`${name} is ${said(value)}, expected a text`);
  if (value.length > longest) throw new RequestError(`${name} has ${value.length} characters, expected at most ${longest}`);
  return value;
}

/** A value as it was sent, cut short. */
function said(value: unknown): string {
  let written: string | undefined;
  try {
    written = JSON.stringify(value);
  } catch {
    // A structure that contains itself, or a number too large for JSON.
  }
  return (written ?? typeof value).slice(0, 60);
}
