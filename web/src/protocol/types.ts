/**
 * Messages and documents as the client uses them, from the server's own types in `generated.ts`. Normative: `server/PROTOCOL.md`
 * for the stream, `/api/v1/openapi.json` for REST.
 */

import type * as Server from "./generated";

/** Makes received values immutable. */
type Immutable<T> = T extends object ? { readonly [K in keyof T]: Immutable<T[K]> } : T;

/** Three numbers: x, y, z. */
export type Vec3 = readonly [number, number, number];

export type ControlPoint = Immutable<Server.ControlPoint>;
export type TransferFunction = Immutable<Server.TransferFunction>;
export type Histogram = Immutable<Server.Histogram>;
export type FieldInfo = Immutable<Server.FieldInfo>;
export type DerivedInfo = Immutable<Server.DerivedInfo>;
export type VolumeInfo = Immutable<Server.VolumeInfo>;
export type UnreadablePath = Immutable<Server.UnreadablePath>;
export type VolumeSummary = Immutable<Server.VolumeSummary>;
export type Statistics = Immutable<Server.Statistics>;
export type GuardName = Server.GuardName;
export type TriangleBudget = Immutable<Server.TriangleBudget>;
export type Preparation = Immutable<Server.Preparation>;
export type Capabilities = Immutable<Server.Capabilities>;
export type Problem = Immutable<Server.Problem>;
export type SessionInfo = Immutable<Server.SessionInfo>;
export type EmbedInfo = Immutable<Server.EmbedInfo>;
export type JobInfo = Immutable<Server.JobInfo>;
export type UploadInfo = Immutable<Server.UploadInfo>;
export type UploadList = Immutable<Server.UploadList>;

export type ViewCamera = Immutable<Server.ViewCamera>;
export type PixelError = Immutable<Server.PixelError>;

/** In the stream a camera is a message of its own. */
type EditFields = Omit<Immutable<Server.Edit>, "camera">;
/** `beta` is in force, or `error` and one of `triangles` and `bytes`, or one of these; a feature may have no range. */
type Optional = "beta" | "error" | "triangles" | "bytes" | "featureRange";

/** Every value in force, as `opened` states it. */
export type View = Required<Omit<EditFields, Optional>> & { readonly [K in Optional]?: EditFields[K] | undefined };

/** Values to change; all others keep theirs. A value that is `undefined` is not sent. */
export type Edit = Partial<View>;

type EditMessage = { readonly type: "edit"; readonly surface?: number } & Edit;
export type ClientMessage = Exclude<Immutable<Server.ClientMessage>, { readonly type: "edit" }> | EditMessage;

type OpenedMessage = Extract<Immutable<Server.ServerMessage>, { readonly type: "opened" }>;
export type ServerMessage =
  | Exclude<Immutable<Server.ServerMessage>, OpenedMessage>
  | (Omit<OpenedMessage, "edit"> & { readonly edit: View });

/** A client's question about a surface. */
export type Question = Extract<ClientMessage, { readonly type: "probe" | "distribution" | "curve" | "annotate" }>;
type Message<T extends ServerMessage["type"]> = Extract<ServerMessage, { readonly type: T }>;
export type Curve = Message<"curve">;
export type Distribution = Message<"distribution">;
export type Probed = Message<"probed">;
export type Group = Message<"group">;
export type Led = Message<"led">;
export type Posed = Message<"posed">;
/** A client's message about a group. */
export type GroupMessage = Extract<ClientMessage, { readonly type: "lead" | "leave" | "pose" | "ask-control" | "give-control" }>;
export type Annotated = Message<"annotated">;
/** Messages of the server, without heartbeats, which concern only the connection. */
export type StreamMessage = Exclude<ServerMessage, Message<"heartbeat">>;
