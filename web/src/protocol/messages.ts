/** Parser of the server's text frames. Pure. */

import type { ServerMessage } from "./types";

/** A text frame that violates the protocol. */
class MessageError extends Error {
  override readonly name = "MessageError";
}

type Kind = "number" | "string" | "boolean" | "object";

/** Fields of each message and their JSON types; the insides of objects are not checked. */
const FIELDS: Readonly<Record<ServerMessage["type"], Readonly<Record<string, Kind>>>> = {
  opening: { bytes: "number", totalBytes: "number" },
  opened: { volume: "object", step: "number", edit: "object", device: "string", capabilities: "object" },
  stepped: { step: "number" },
  described: { volume: "object", step: "number" },
  prefix: {
    surface: "number",
    generation: "number",
    level: "number",
    kind: "string",
    mesher: "string",
    regions: "number",
    unchanged: "number",
    triangles: "number",
    final: "boolean",
  },
  committed: { surface: "number", generation: "number", level: "number", final: "boolean" },
  done: { surface: "number", generation: "number", statistics: "object" },
  measured: { surface: "number", generation: "number", error: "object", regions: "object" },
  probed: { surface: "number", generation: "number", position: "object", inside: "boolean", values: "object" },
  distribution: {
    surface: "number",
    generation: "number",
    kind: "string",
    bins: "object",
    coarse: "object",
    coarseShare: "number",
  },
  annotated: { surface: "number", generation: "number", annotation: "string", regions: "number" },
  curve: { surface: "number", generation: "number", kind: "string", byError: "boolean", points: "object" },
  superseded: { surface: "number", generation: "number" },
  removed: { surface: "number" },
  group: { group: "string", you: "number", control: "number", followers: "number", asks: "boolean", people: "object" },
  led: { volume: "string", step: "number", surfaces: "object" },
  posed: {},
  left: { reason: "string" },
  heartbeat: { seconds: "number" },
  error: { code: "string", message: "string", open: "boolean" },
};

/**
 * Parses one text frame.
 * @throws MessageError naming the field at fault
 */
export function parseServerMessage(text: string): ServerMessage {
  let value: unknown;
  try {
    value = JSON.parse(text);
  } catch {
    throw new MessageError(`server message is not JSON: ${text.slice(0, 80)}`);
  }
  if (typeof value !== "object" || value === null) throw new MessageError("server message is not an object");
  const message = value as Record<string, unknown>;
  const type = message["type"];
  if (typeof type !== "string" || !Object.hasOwn(FIELDS, type)) {
    throw new MessageError(`server message of unknown type ${JSON.stringify(type)}`);
  }
  for (const [field, kind] of Object.entries(FIELDS[type as ServerMessage["type"]])) {
    if (typeof message[field] !== kind || message[field] === null) {
      throw new MessageError(`server message ${type}: ${field} is ${JSON.stringify(message[field])}, expected ${kind}`);
    }
  }
  return message as ServerMessage;
}
