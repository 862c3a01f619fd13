/** Generated from the server's types: `make generated` writes it anew. */

/** Levels are 0 (finest) to `LEVELS` - 1. */
export const LEVELS = 6;

/** Cells along a region's edge. */
export const REGION_CELLS = 32;

/** Maximum number of control points. */
export const MAX_POINTS = 64;

/** Subprotocol of the WebSocket. */
export const SUBPROTOCOL = "isopeel.v3";

/** Functions of expressions over fields. */
export const EXPRESSION_FUNCTIONS = ["abs", "sqrt", "exp", "log", "log2", "log10", "sin", "cos", "tan", "floor", "ceil", "min", "max", "pow", "clamp", "magnitude", "if", "distance", "smooth"] as const;

/** What a surface is annotated with. */
export type Annotation = "error" | "error-around";

/** Meaning of the positions along an axis. */
export type AxisInfo = {
  /** Name in the file. */
  name: string,
  /** Unit of the positions, as the file says it. */
  unit: string | null,
  /** Kind of the positions: `longitude`, `latitude`, `depth`, `height`, `pressure` or `other`. */
  kind: string,
  /** Position of each sample, if the world's coordinates count samples; null: the world's coordinate along the axis is the position. */
  positions: Array<number> | null,
  /** Whether positions grow downwards: if `positions` is null, they are then the world's coordinates times −1. */
  pointsDown: boolean,
};

/** A box along the axes of the world. */
export type Box = {
  /** Minimum along each axis. */
  min: [number, number, number],
  /** Maximum along each axis, above the minimum. */
  max: [number, number, number],
};

/** Position and target of a camera, in the world. */
export type Camera = {
  /** Position of the camera. */
  position: [number, number, number],
  /** Position around which the camera orbits. */
  target: [number, number, number],
  /** How it shows depth. */
  projection: Projection,
};

/** Optional functions that this server supports. */
export type Capabilities = {
  /** Maximum number of surfaces of a connection. The numbers of surfaces are lower than this. */
  surfaces: number,
  /** Kinds of chunks that the server may send. */
  chunkKinds: Array<ChunkKind>,
  /** Whether the server may send `measured` after `done`. */
  measuredError: boolean,
  /** Whether the server supports `step`. */
  steps: boolean,
  /** Whether volumes and time steps may appear while the server runs. */
  watches: boolean,
  /** Whether the server supports `lead` and `join`. */
  groups: boolean,
  /** Types of messages that ask about a surface. */
  questions: Array<string>,
};

/** Why something has no result. */
export type Cause = {
  /** Stable code for programs: a code of the problem documents, `input-changed`, `attempts-exhausted` or `over-quota`. */
  code: string,
  /** Explanation for users. */
  detail: string,
};

/**
 * Parts (connected components) of the surface. Each position, in world coordinates, chooses the part whose surface is nearest to it; if
 * there is no surface in the two cells around it, the position chooses nothing. 1 to 64 positions.
 */
export type ChosenParts = { "hide": Array<[number, number, number]> } | { "keep": Array<[number, number, number]> };

/** What a chunk's triangles are; the wire has it as a number in chunks and as text in messages. */
export type ChunkKind = "cut" | "error";

/** Changes made by `clean` or `cap`. */
export type Cleaned = {
  /** Pairs of triangles that intersected in the file's numbers, after the cut was refined. */
  intersections: number,
  /** Triangles before the cut was refined at intersecting triangles. The budget holds before and after. */
  trianglesBefore: number,
  /** Triangles after the refinement. */
  trianglesAfter: number,
  /** Cuts that were made after the first one; 0 also if the surface is not a cut of the vertex tree. */
  rounds: number,
  /** Vertices that were moved, because their triangles still intersected. */
  movedVertices: number,
  /** Largest distance by which a vertex was moved, in the file's unit. */
  largestMove: number,
  /** Edges between nearly coplanar triangles that were flipped, so that mesh generators flip none. */
  flippedEdges: number,
  /** Such edges that `clean` could not flip. TetGen may end with an error there. */
  unflippedEdges: number,
};

/** A text frame from a client. */
export type ClientMessage = { "type": "open",
  /** Id of the volume. */
  volume: string,
  /** Time step. */
  step: number,
  /**
   * Names of codings that the client can decode in addition to the one that every client can. The server ignores names that it does
   * not know.
   */
  codings: Array<string>,
} | { "type": "step",
  /** Number of the time step. */
  step: number,
} | { "type": "edit" } & SurfaceEdit | { "type": "cancel",
} | { "type": "remove",
  /** Number of the surface. */
  surface: number,
} | { "type": "drawn",
  /** Generation whose prefix is on screen. */
  generation: number,
} | { "type": "probe",
  /** Number of the surface. */
  surface: number,
  /** Position in world coordinates. */
  position: [number, number, number],
} | { "type": "distribution",
  /** Number of the surface. */
  surface: number,
  /** Bins from 0 to 1. */
  bins: number,
} | { "type": "curve",
  /** Number of the surface. */
  surface: number,
} | { "type": "annotate",
  /** Number of the surface. */
  surface: number,
  /** The requested annotation. */
  annotation: Annotation,
} | { "type": "lead",
  /** The group that was led on another connection. */
  resume: Resume | null,
  /** As `codings` of `open`, for a connection that has opened no volume. */
  codings: Array<string>,
} | { "type": "join",
  /** Id of the group. */
  group: string,
  /** Name that the leader sees. */
  name: string | null,
  /** As `codings` of `open`, for a connection that has opened no volume. */
  codings: Array<string>,
} | { "type": "heartbeat",
} | { "type": "leave",
} | { "type": "camera",
  /** The camera; null: none of its own. */
  camera: ViewCamera | null,
} | { "type": "pose" } & Pose | { "type": "ask-control",
  /** True to ask for control, false to withdraw the request. */
  asks: boolean,
} | { "type": "give-control",
  /** Number of the follower; 0: the leader. */
  to: number,
};

/** One control point. */
export type ControlPoint = {
  /** Position on the blended feature, 0 to 1. */
  x: number,
  /** Importance there, 0 to 1. */
  importance: number,
  /** Colour there, `#rrggbb`. */
  color: string,
};

/** A cut of a curve. */
export type CurvePoint = {
  /** Triangles of its surface. */
  triangles: number,
  /** Estimated error, root mean square in world units. */
  rms: number,
  /** Tolerance, world units, or β; below 0 for the full surface. */
  threshold: number,
};

/**
 * A feature computed from one field or from three. Its values are described only if they have been computed before; those of
 * `gradient-magnitude` always are.
 */
export type DerivedInfo = {
  /** Unit of the values; null if it depends on units of fields that are not declared, or that differ. */
  unit: string | null,
  /** Minimum and maximum, if they are known. */
  range?: [number, number],
  /** Distribution of the values, if it is known. */
  histogram?: Histogram,
};

/** Which parts of a surface are fine. */
export type Detail = "view" | "uniform";

/** Any subset of what can be edited; what is absent stays as it was. */
export type Edit = {
  /** Isovalue, in the field's units. */
  iso?: number,
  /** Field whose isosurface is shown, or an expression over fields such as `log(rho)`. */
  field?: string,
  /**
   * Restricts the surface to samples at which a field of the volume has certain values, `labels==3`; null: no restriction. Cells that
   * touch other samples have no surface, as beside missing samples.
   */
  mask?: string | null,
  /**
   * Feature that matters to the user: a field's name, a feature of the shown field such as `gradient-magnitude`, a feature of three
   * fields such as `divergence(u,v,w)`, an expression over fields such as `magnitude(u,v,w)`, the distance to the nearest sample at
   * which a condition holds, such as `distance(labels==3)`, or `none`.
   */
  feature?: string,
  /** Feature values that become 0 and 1, in the feature's units; the feature's own range when never given. */
  featureRange?: [number, number],
  /**
   * Field whose values at the vertices are sent for colours, or an expression over fields; null: none. It changes no triangle. The field
   * of `feature` needs no such values: chunks have it already. Files have no such values, but those of `fieldValues`.
   */
  colorField?: string | null,
  /** Weight of the feature against smoothness, 0 to 1. */
  alpha?: number,
  /**
   * Importance up to which a cube is decimated; below 0 gives the full surface. An export with it is exactly that cut:
   * guards that it does not name are off. What decides is β, or an error and a budget: an edit that names one of `beta`,
   * `error`, `triangles` and `bytes` takes the place of all four.
   */
  beta?: number,
  /**
   * How far the surface may be decimated, instead of `beta`: a part is merged up to this error over its weight, which falls
   * with importance and grows with the distance to the camera. In pixels it is that within which nearly all of what the camera sees lies;
   * without a camera, a pixel counts as a tenth of the smallest spacing.
   */
  error?: ErrorLimit,
  /**
   * Maximum triangles, instead of `beta`: the smallest tolerance that keeps it is found. Beside `error`, the greater of both
   * decides.
   */
  triangles?: TriangleBudget,
  /** Maximum bytes on the wire, as `triangles`. */
  bytes?: number,
  /**
   * Parts of the surface, those that nothing connects, with a smaller area are removed first; world units, 0 or more. 0 or null:
   * none are. Beside `error`, `triangles` or `bytes`, with the dual mesher: an edit that lets β decide, or another mesher, ends it.
   */
  minPart?: number | null,
  /**
   * Parts that are chosen by positions: hidden, or kept while all others are removed; null: all are shown. As `minPart`, with which
   * both combine.
   */
  parts?: ChosenParts | null,
  /** Guard: largest distance of a decimated part to the surface it stands for. */
  maxError?: MaxError,
  /** Guard: whether decimation may change the topology. */
  topology?: TopologyName,
  /** Mesher that turns the cut into triangles. */
  mesher?: MesherName,
  /** Whether surfaces that leave the volume are closed on its faces. Exports only. */
  cap?: boolean,
  /** Coarsest level, 0 to 5. */
  maxLevel?: number,
  /** Importance and colour over the blended feature. */
  transferFunction?: TransferFunction,
  /** Regions of interest, in which importance is raised, at most 64. They replace those set before. */
  interest?: Array<Interest>,
  /**
   * Whether what the camera sees from near is finer, or every part alike. Of a surface that an error or a budget decides, with the dual
   * mesher.
   */
  detail?: Detail,
  /** Camera for which the surface is made. Requests only: in the stream, the message `camera` has it. */
  camera?: ViewCamera,
};

/** Pages that may embed the viewer in a frame. */
export type EmbedInfo = {
  /** Origins of these pages, in addition to the server's own. Only they may pass a token to the viewer. */
  origins: Array<string>,
};

/**
 * Limit on the error of a surface: a distance, or pixels of the picture that a camera makes of it. In JSON a number of world units, or text
 * such as `0.25vx` or `1px`.
 */
export type ErrorLimit = number | string;

/** What a job is expected to cost, from the full surfaces of some of its extractions. */
export type Estimate = {
  /** Maximum triangles: those of the full surfaces, or the budgets if these are lower. */
  triangles: number,
  /** Maximum bytes of the results. */
  bytes: number,
  /** Seconds on an idle device. */
  seconds: number,
};

/**
 * Distance of a mesh from the surface it stands for, in world units, as estimated by the quadrics of its leaves. Known before anything is
 * measured, and not a bound: vertices may be farther away.
 */
export type EstimatedError = {
  /** Root mean square over the surface. */
  rms: number,
  /** Root mean square of the worst leaf. */
  worstLeaf: number,
};

/** An extraction that failed. */
export type Failure = {
  /** Number of the extraction, from 0. */
  extraction: number,
  /** Stable code for programs: a code of the problem documents, `input-changed`, `attempts-exhausted` or `over-quota`. */
  code: string,
  /** Explanation for users. */
  detail: string,
};

/** A field, or a feature made from one. */
export type FieldInfo = {
  /** Name, as edits use it. */
  name: string,
  /** Type of the samples on the device: `u8`, `i8`, `u16`, `i16` or `f32`. */
  type: string,
  /** Type of the samples in the file, as its format names it; absent for computed values. */
  storedType?: string,
  /** Unit of the values, if the file declares one. */
  unit: string | null,
  /** Meaning of the values, in ascending order, if this is a field of labels and the file describes them. */
  labels?: Array<Label>,
  /** Minimum and maximum. */
  range: [number, number],
  /** Distribution of the values. */
  histogram: Histogram,
  /** Isovalue that this field opens with, unless the volume comes with one; absent if this is a feature. */
  openingIso?: OpeningIso,
  /** Features that are computed from this field when its isosurface is made, by their names in edits; empty if this is a feature itself. */
  derivedFeatures: { [key in string]: DerivedInfo },
};

/** A field at a position. */
export type FieldValue = {
  /** Name of the field. */
  field: string,
  /** Trilinearly interpolated value in the field's units; null if there is none. */
  value: number | null,
  /** Why there is no value. */
  why?: NoValue,
};

/** A follower, as the leader sees it. */
export type Follower = {
  /** Number of the follower in the group, 1 or more. */
  number: number,
  /** Name that the follower has chosen; null if it has none. */
  name: string | null,
  /** Whether the follower asks for control. */
  asks: boolean,
};

/**
 * Positions of samples: `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`. Along an axis with `positions`, the entry of
 * `positions[axis]` at the index takes the place of `spacing[axis] · index[axis]`.
 */
export type Geometry = {
  /** Samples along x (fastest), y, z. */
  dims: [number, number, number],
  /** World units between samples; along an uneven axis their mean. */
  spacing: [number, number, number],
  /**
   * Position of each sample along the uneven axes among x, y, z, ascending, world units from the first one; null for an even axis.
   * Absent if all axes are even. If present, distances, areas and errors of surfaces are upper bounds: those in a grid whose cells are
   * all as large as the largest along each axis.
   */
  positions?: [Array<number> | null, Array<number> | null, Array<number> | null],
  /** World position of sample (0, 0, 0). */
  origin: [number, number, number],
  /** Unit vectors of the axes x, y, z in the world. */
  direction: [[number, number, number], [number, number, number], [number, number, number]],
  /**
   * Directions of the world's axes: `LPS` (of a patient: left, back, head), `RAS` (right, front, head), `world` if the file does not
   * say, `index` if positions count samples.
   */
  frame: string,
  /** Unit of lengths in the world, such as `mm`, if the file states it. */
  unit: string | null,
};

/** A guard, which limits what decimation may change. */
export type GuardName = "max-error" | "topology";

/** How often values occur, in equal bins. */
export type Histogram = {
  /** Lower bound of the first bin. */
  min: number,
  /** Upper bound of the last bin. */
  max: number,
  /** Samples in each of the 256 bins; for a volume of more than 2^27 samples, only samples of a share of its planes. */
  counts: Array<number>,
};

/** A region of interest, in world coordinates: a sphere or a box. Importance inside is at least its own. */
export type Interest = {
  /** The sphere; without it, there is a box. */
  sphere?: Sphere,
  /** The box. */
  box?: Box,
  /** Importance, 0 to 1. */
  importance: number,
};

/** Rule by which an isovalue was chosen. */
export type IsoReason = "bone" | "labels" | "background-left-out" | "whole-histogram" | "no-surface";

/** A batch job. */
export type JobInfo = {
  /** Id of the job. */
  id: string,
  /** Id of the job's volume. */
  volume: string,
  /** State of the job. */
  state: JobState,
  /** Why the job is paused: `disk-full` or `storage`. Absent if it is not paused. The job resumes by itself. */
  paused?: string,
  /** Numbers of the job's extractions. */
  extractions: Progress,
  /** Total bytes of the results. */
  bytes: number,
  /** Expected cost of the job. */
  estimate: Estimate,
  /** Estimated seconds until the job is done, if it runs and the time can be estimated. */
  etaSeconds?: number,
  /** When the job was submitted, in seconds since 1970. */
  submitted: number,
  /** When the job's first extraction began, in seconds since 1970. */
  started?: number,
  /** When the job was done, failed or cancelled, in seconds since 1970. */
  finished?: number,
  /** Why the job failed. */
  error?: Cause,
  /** The first hundred extractions that failed. Only in the description of a single job. */
  failures?: Array<Failure>,
};

/** State of a batch job. */
export type JobState = "queued" | "running" | "done" | "failed" | "cancelled";

/** A label: a value of a field, and what it means. */
export type Label = {
  /** Value of the samples, as edits use it. */
  value: number,
  /** Number in the file, if it differs from `value`: 32-bit floats do not hold all numbers above 16777216. */
  stored?: string,
  /** Name for users. */
  name: string | null,
  /** Colour, `#rrggbb`. */
  color: string | null,
};

/** What the leaves of a surface are. */
export type LeafKind = "cubes" | "tree";

/** A surface of the member in control. */
export type LedSurface = {
  /** Number of the surface. */
  surface: number,
  /** The values of all parameters. */
  edit: Edit,
};

/** Guard on the error: how far a decimated part may be from the surface it stands for. In JSON a distance, null or `none`, or `auto`. */
export type MaxError = number | string | null;

/** Measured distance of a mesh from the surface it stands for, in world units. */
export type MeasuredError = {
  /** Root mean square of the distance. */
  rms: number,
  /** Maximum of the distance. */
  max: number,
};

/** Which mesher turns the cut into triangles. */
export type MesherName = "dual" | "marching-cubes";

/** The leaf that stands for a part of the surface. */
export type NearestLeaf = {
  /** Kind of the leaf. */
  kind: LeafKind,
  /** Level of the leaf. */
  level: number,
  /** Estimated error of the leaf, root mean square in world units. */
  error: number,
};

/** The full surface's vertex that is nearest to a position. */
export type NearestSurface = {
  /** Distance from the position to the vertex, in world units. */
  distance: number,
  /** Smoothness feature. */
  smoothness: number,
  /** User feature, in the feature's own units. */
  feature: number,
  /** Blend of both features: the input of the transfer function. */
  blended: number,
  /** Importance. */
  importance: number,
  /** The leaf that stands for it in the surface that is shown; null if that surface has none there, or if the leaf is not known. */
  leaf: NearestLeaf | null,
  /**
   * Number of its part in the full surface: the same at all places of one part, as long as isovalue, field and guards stay; null as
   * `partArea`.
   */
  part: number | null,
  /**
   * Area of its part in the full surface, world units; null if it belongs to no part, and if parts are not known: the surface is not a
   * cut of the tree, or it is large and no part of it has been removed yet.
   */
  partArea: number | null,
};

/** Why there is no value. */
export type NoValue = "missing" | "not-resident";

/** The isovalue that a field opens with. */
export type OpeningIso = {
  /** Isovalue, in the field's units. */
  iso: number,
  /** Stable code of the reason for this isovalue. */
  reason: IsoReason,
  /** Reason for this isovalue, as text for users. */
  explanation: string,
};

/** Which side of a surface is its outside: the one that its triangles and normals show. */
export type Outward = "auto" | "high" | "low";

/** Error of a surface in its camera's picture, as expected from the tree's quadrics. It is no bound. */
export type PixelError = {
  /** Pixels within which nearly all of what the camera sees lies: twice the root mean square. */
  within: number,
  /** What decides. */
  limitedBy: PixelLimit,
};

/** What decides how fine a surface is in its camera's picture. */
export type PixelLimit = "error" | "budget" | "pixels" | "guard" | "data";

/** What the page of the member in control shows beside its surfaces. */
export type Pose = {
  /** Camera of the page. */
  camera?: Camera,
  /** State of the page in a format of its own: the server forwards it without reading it. */
  page?: string,
};

/** Progress of the steps before a device's first surface. */
export type Preparation = {
  /** Number of steps that are done. */
  done: number,
  /** Total number of steps; 0 if it is not known. */
  of: number,
};

/** Body of every error answer. */
export type Problem = {
  /** URI of the kind of problem: `urn:isopeel:problem:` and the code. */
  type: string,
  /** The HTTP status in words. */
  title: string,
  /** The HTTP status. */
  status: number,
  /** What was wrong and what was expected. */
  detail: string,
  /**
   * What programs tell problems apart by: `bad-edit`, `bad-job`, `bad-json`, `bad-range`, `bad-request`, `bad-slice`, `bad-upload`, `body-too-large`,
   * `busy`, `device`, `disk-full`, `empty-surface`, `forbidden`, `foreign-host`, `foreign-origin`, `input-changed`, `internal`, `job-finished`, `job-not-finished`,
   * `jobs-off`, `key-reused`, `method-not-allowed`, `no-result`, `not-found`, `over-budget`, `over-declared`, `over-quota`, `taken-over`, `too-large`, `too-many-jobs`,
   * `too-many-requests`, `too-many-tickets`, `too-many-uploads`, `unauthorized`, `unknown-field`, `unknown-job`, `unknown-step`, `unknown-upload`,
   * `unknown-volume`, `unreadable-volume`, `unsupported-media-type`, `unsupported-version`, `upload-finished`, `upload-incomplete`, `upload-locked`,
   * `uploads-off` or `wrong-offset`.
   */
  code: string,
  /** If the surface has more triangles than a limit (`too-large`) or its budget (`over-budget`) allows: a budget (`triangles`) to try. */
  suggestedTriangles?: number,
};

/** Numbers of a job's extractions. */
export type Progress = {
  /** Total number of extractions. */
  total: number,
  /** Number of extractions with a result. */
  done: number,
  /** Number of extractions without a result after three attempts, or after the first one if a retry would not help. */
  failed: number,
  /** Number of extractions without a result because the surface has no triangles. */
  empty: number,
};

/** How a camera shows depth. */
export type Projection = "perspective" | "orthographic";

/** The measured error of a region, in world units. */
export type RegionError = {
  /** Position of the region, in units of 32 cells. */
  region: [number, number, number],
  /** Root mean square of the distance. */
  rms: number,
  /** Maximum of the distance. */
  max: number,
};

/** Credentials with which a leader resumes its group on another connection. */
export type Resume = {
  /** Id of the group. */
  group: string,
  /** Key from the message `group` to the leader. */
  key: string,
};

/** A role of a user: a set of operations that the user may request. */
export type Role = "view" | "edit" | "export" | "upload" | "push" | "admin";

/** A text frame from the server. */
export type ServerMessage = { "type": "opening",
  /** Bytes of files and samples that the server has processed so far. */
  bytes: number,
  /** Bytes that the server has to process in total. */
  totalBytes: number,
  /** Progress of the device's preparation, before the server reads the volume. */
  device?: Preparation,
} | { "type": "opened",
  /** As `GET /api/v1/volumes/{id}`. */
  volume: VolumeInfo,
  /** Time step. */
  step: number,
  /** The values of all parameters. */
  edit: Edit,
  /** Name of the device. */
  device: string,
  /** Optional functions that this server supports. */
  capabilities: Capabilities,
} | { "type": "stepped",
  /** Number of the time step. */
  step: number,
  /** Time of the step as text for users, if the file has times. */
  label: string | null,
} | { "type": "described",
  /** As `GET /api/v1/volumes/{id}` of that step. */
  volume: VolumeInfo,
  /** Time step. */
  step: number,
} | { "type": "prefix",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Level of the prefix. */
  level: number,
  /** Kind of the chunks. */
  kind: ChunkKind,
  /** Mesher that made the chunks. */
  mesher: MesherName,
  /** Number of chunks that follow. */
  regions: number,
  /** Number of regions that the client keeps unchanged. */
  unchanged: number,
  /** Triangles of the whole surface once this prefix is committed. */
  triangles: number,
  /** Field whose values chunks with values have. */
  colorField?: string,
  /** Whether this is the final surface of the edit. */
  final: boolean,
} | { "type": "committed",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Level of the prefix. */
  level: number,
  /** Whether this is the final surface of the edit. */
  final: boolean,
} | { "type": "done",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Id of the edit in the server's log: 16 hexadecimal digits. */
  trace: string,
  /** As `isopeel extract --stats` prints them. */
  statistics: Statistics,
} | { "type": "measured",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Error of the whole surface. */
  error: MeasuredError,
  /** Error of each region that has triangles. */
  regions: Array<RegionError>,
} | { "type": "probed",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface that was probed; 0 if no surface is shown. */
  generation: number,
  /** The position, in the world. */
  position: [number, number, number],
  /** Whether it is in the volume. */
  inside: boolean,
  /** Every field there; none outside. */
  values: Array<FieldValue>,
  /** The surface next to it; null if there is none within two cells. */
  nearest: NearestSurface | null,
} | { "type": "distribution",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Kind of the leaves. */
  kind: LeafKind,
  /** Number of vertices in each of the equal bins from 0 to 1. */
  bins: Array<number>,
  /** Number of those vertices whose leaf stands for several vertices, in each bin. */
  coarse: Array<number>,
  /** Share of `coarse` in all vertices. */
  coarseShare: number,
} | { "type": "curve",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Kind of the leaves of the cuts. */
  kind: LeafKind,
  /** Whether thresholds are tolerances, or else β. */
  byError: boolean,
  /** Cuts from the full surface to the coarsest. */
  points: Array<CurvePoint>,
} | { "type": "annotated",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
  /** Annotation that the chunks hold. */
  annotation: Annotation,
  /** Number of chunks that follow. */
  regions: number,
} | { "type": "superseded",
  /** Number of the surface. */
  surface: number,
  /** Generation of the surface. */
  generation: number,
} | { "type": "removed",
  /** Number of the surface. */
  surface: number,
} | { "type": "group",
  /** Id of the group, which a link to it contains. */
  group: string,
  /** The viewer's own number in the group; 0: the viewer leads. */
  you: number,
  /** Number of the member in control. */
  control: number,
  /** Number of followers. */
  followers: number,
  /** Whether the viewer asks for control. */
  asks: boolean,
  /** Whether the leader's connection is lost, so that the group waits for the leader. */
  leaderAway: boolean,
  /** Only for the leader: the key with which it resumes the group on another connection. */
  key?: string,
  /** Only for the leader: some of the followers, first those who ask for control. */
  people: Array<Follower>,
} | { "type": "led",
  /** Id of the volume. */
  volume: string,
  /** Time step. */
  step: number,
  /** The surfaces, with the values of all parameters. */
  surfaces: Array<LedSurface>,
} | { "type": "posed",
  /** Camera of the page. */
  camera?: Camera,
  /** State of the page in a format of its own: the server forwards it without reading it. */
  page?: string,
} | { "type": "heartbeat",
  /** Seconds until the next heartbeat. */
  seconds: number,
} | { "type": "left",
  /** Why the viewer is no longer in the group. */
  reason: string,
} | { "type": "error",
  /** Stable code for programs. */
  code: string,
  /** What was wrong and what was expected. */
  message: string,
  /** Whether the connection stays open. */
  open: boolean,
  /** Number of the surface whose generation failed. */
  surface?: number,
  /** With `too-large`, if the surface has too many triangles: a budget that is within the limit. */
  suggestedTriangles?: number,
};

/** What the client may do. */
export type SessionInfo = {
  /** Roles of the client, with those that they imply: `edit` implies `view`, and `admin` implies all. */
  roles: Array<Role>,
  /** Seconds until the client's token expires; `null`: it does not expire. */
  expiresSeconds: number | null,
  /** Whether the client may submit batch jobs: the server runs them (`--state-folder`), and the client has the role `export`. */
  jobs: boolean,
  /** Whether the client may upload volumes: the server accepts them (`--uploads`), and the client has the role `upload`. */
  uploads: boolean,
};

/** The shape of the surface in a file. */
export type Shape = {
  /** The side that triangles and normals face: that of high or that of low values. */
  outward: Outward,
  /** Vertices of the file beyond those of the surface: sheets that touch get vertices of their own. */
  splitVertices: number,
  /** Whether each edge has two triangles. */
  isClosed: boolean,
  /** The volume that a closed surface encloses, in cubes of the file's unit. */
  volume: number | null,
  /**
   * Pairs of triangles that share more than corners and edges. Null: not counted, because the error was not measured and neither `clean`
   * nor `cap` asks for the count.
   */
  selfIntersections: number | null,
  /** Cost of the repair, of the whole surface (`clean`) or at its caps (`cap`). Null: neither was asked for. */
  cleaned: Cleaned | null,
};

/** A share of the full surface's triangles. */
export type ShareBudget = {
  /** The share, above 0 and up to 1. */
  share: number,
  /** Maximum triangles, whatever the share is. */
  max?: number,
};

/** A sphere. */
export type Sphere = {
  /** Centre of the sphere. */
  center: [number, number, number],
  /** Radius, above 0. */
  radius: number,
};

/** Counts, times and bytes of one surface. */
export type Statistics = {
  /** Mesher that made the surface. */
  mesher: MesherName,
  /**
   * Importance up to which cubes were decimated: as given, or for marching cubes as found for a budget. Null: an error or a
   * budget decided.
   */
  beta: number | null,
  /**
   * Error over weight up to which parts were merged, world units: as given, or as found for a budget. Below 0: nothing was
   * merged. Null: β decided.
   */
  tolerance: number | null,
  /** Guard on the error of a decimated part, world units; null: off. */
  maxError: number | null,
  /** The setting that was in force: whether decimation could change the topology. */
  topology: TopologyName,
  /** Values of the feature that count as 0 and 1: as given, or its own range. Null: no feature. */
  featureRange: [number, number] | null,
  /** Guards that were `auto` and were relaxed to keep the budget, in this order: first the error, then the topology. */
  gaveWay: Array<GuardName>,
  /** Whether this is a cut of the vertex tree, or else of the octree. */
  isTreeCut: boolean,
  /**
   * Distance from the surface it stands for: over every full-resolution crossing the distance to the nearest triangle
   * around its leaf's vertex, and the distance of each triangle's centre to the isosurface. Null: not measured.
   */
  error: MeasuredError | null,
  /** The same distance as the leaves' quadrics estimate it. Null: not known. */
  estimatedError: EstimatedError | null,
  /** Error in the picture of the camera that the surface was made for. Null: it was made for no camera, or is a cut of the octree. */
  pixels: PixelError | null,
  /** Triangles of the undecimated marching-cubes surface, without removed parts. */
  fullTriangles: number,
  /** Triangles of the undecimated surface by the mesher of this one, without removed parts. Null: not counted. */
  mesherTriangles: number | null,
  /**
   * Parts that were removed, because of `minPart` or `parts`. Null: removal was not asked for, or this is a cut of the octree, which
   * contains all parts.
   */
  removedParts: number | null,
  /**
   * Triangles of the removed parts in the undecimated marching-cubes surface; those of a cell with several parts count for one of them.
   * Null as `removedParts`.
   */
  removedTriangles: number | null,
  /** Positions of `parts` with no surface next to them, which selected nothing. Null as `removedParts`. */
  unmatchedPositions: number | null,
  /**
   * Small parts that the cut leaves out, because no cut with all parts is within the budget, or because `topology` is `free`.
   * Null: this is a cut of cubes, in which parts that vanish are not counted.
   */
  vanishedParts: number | null,
  /** Cells that the surface crosses. */
  activeCells: number,
  /** Leaves of the cut at each level, 0 (finest) first. */
  leaves: [number, number, number, number, number, number],
  /** Triangles of this surface. */
  triangles: number,
  /** Distinct vertices of this surface: a vertex shared by regions counts once. */
  vertices: number,
  /** Decimated cubes whose corners all have the same sign: they emit no triangles. */
  lostCubes: number,
  /** Vertices on a coarser leaf's face that stayed, because that leaf has no segment there to move to. */
  unpatchedVertices: number,
  /** Device time by stage, milliseconds by the device's own events. */
  stagesMs: { [key in string]: number },
  /** Milliseconds from the start of the work to the surface, without time spent waiting for the device or reading files. */
  wallMs: number,
  /** Peak of bytes allocated on the device beyond resident volumes. */
  deviceBytes: number,
  /** Bytes of the resident volumes this surface was made from. */
  volumeBytes: number,
  /** Name of the device. */
  device: string,
  /** The shape of a file's surface. Never in the stream. */
  shape?: Shape,
  /** What the format of a file could not keep. Never in the stream. */
  notices?: Array<string>,
};

/** An edit and the number of the surface that it is for; 0 if it is left out. */
export type SurfaceEdit = { surface?: number } & Edit;

/** Times of the steps. */
export type Times = {
  /** The described step, for people: `1850-01-16`, `12.5 s`, `step 007`. */
  label: string,
  /** Labels of all steps, if there are at most 1024. */
  labels: Array<string> | null,
  /** What times count: a unit (`s`), or a unit and a reference date (`days since 1850-01-01`); null if the file does not say. */
  unit: string | null,
  /** Calendar of the dates, by its name in CF; null if times are not dates. */
  calendar: string | null,
  /** Time of step 0; null if it is not a finite number. */
  start: number | null,
  /** Time between steps, if it is constant. */
  spacing: number | null,
  /** Time of every step, if steps are uneven and there are at most 1024; an entry is null if the time is not a number. */
  values: Array<number> | null,
};

/** Whether decimation may change the surface's topology. */
export type TopologyName = "auto" | "preserve" | "free";

/** A transfer function as it travels; the kernels know importance alone, colour is the viewer's. */
export type TransferFunction = {
  /** Control points, 1 to 64. */
  points: Array<ControlPoint>,
};

/** Maximum triangles of a surface: a number, or a share of the full surface. */
export type TriangleBudget = number | ShareBudget;

/** A path that the server was started with and that it cannot read. */
export type UnreadablePath = {
  /** Name of the file or folder. */
  name: string,
  /** What was found in it, and what was expected. */
  reason: string,
};

/** An upload. */
export type UploadInfo = {
  /** Id of the upload, which the server has generated. */
  id: string,
  /** Title for users, from the names of the files. */
  title: string,
  /** User who owns the upload. */
  owner: string,
  /** State of the upload. */
  state: UploadState,
  /** Number of files. */
  files: number,
  /** Total bytes of the files, as declared. */
  bytes: number,
  /** Bytes that the server has received: the offset at which to continue. */
  receivedBytes: number,
  /** When the upload was created (RFC 3339). */
  created: string,
  /** When the server removes the upload (RFC 3339), unless it is used before: a part of it is sent, or one of its volumes is viewed. */
  expires: string,
  /** Ids of the upload's volumes; empty until the server has read its files. */
  volumes: Array<string>,
  /** Why the files could not be read as a volume, if the server has tried. */
  error: string | null,
};

/** The uploads of a user, and the user's quota. */
export type UploadList = {
  /** Maximum bytes of the user's uploads. */
  quotaBytes: number,
  /** Bytes of the user's uploads that count: as declared, or as unpacked if that is more. */
  usedBytes: number,
  /** The uploads, the latest first; for an administrator, those of all users. */
  uploads: Array<UploadInfo>,
};

/** State of an upload. */
export type UploadState = "receiving" | "ready";

/** Three fields that are the components of a vector. */
export type VectorInfo = {
  /** Names of the fields: along the axes x, y, z of the grid. */
  components: [string, string, string],
  /** The features that are computed from them, by their names in edits. */
  features: { [key in string]: DerivedInfo },
};

/** A camera that looks at a surface, in world coordinates. */
export type ViewCamera = {
  /** Position of the camera. */
  position: [number, number, number],
  /** Position that the camera looks at. */
  target: [number, number, number],
  /** Direction that is up in the picture; not that in which the camera looks. */
  up?: [number, number, number],
  /** Vertical field of view of a perspective picture, in degrees, above 0 and below 180. Either this or `height` is given. */
  fov?: number,
  /** Height of a parallel picture, in world units. */
  height?: number,
  /** Width and height of the picture in pixels. */
  viewport: [number, number],
};

/** A volume: the description of one time step for the editor. */
export type VolumeInfo = {
  /** Stable id in URLs and messages. */
  id: string,
  /** Title for users. */
  title: string,
  /** Positions of the samples. */
  geometry: Geometry,
  /** Time steps, at least 1. */
  steps: number,
  /** The time step that ranges and histograms describe. */
  step: number,
  /** Meaning of the positions along the axes x, y and z; null for an axis that the file does not describe; absent if it describes none. */
  axes?: [AxisInfo | null, AxisInfo | null, AxisInfo | null],
  /** Times of the steps, if the file states them and there are several steps. */
  times: Times | null,
  /** Fields, the main one first. */
  fields: Array<FieldInfo>,
  /** Features, besides `none`, whose values are known: those derived from a field (here from the main one), then every field. */
  features: Array<FieldInfo>,
  /** Vector fields, known by the names of their components, with the features that are computed from them. */
  vectors: Array<VectorInfo>,
  /**
   * Notices to be shown with the data, one a line: copyright and source; what the file's reader repaired, assumed or interpolated; and
   * values that the device's type cannot hold, once they were read.
   */
  notice: string | null,
  /** Edit that the viewer opens with, if the volume comes with one. */
  opening: Edit | null,
};

/** Summary of a volume. */
export type VolumeSummary = {
  /** Stable id in URLs and messages. */
  id: string,
  /** Title for users. */
  title: string,
  /** Samples along x, y, z. */
  dims: [number, number, number],
  /** Time steps, at least 1. */
  steps: number,
  /** Names of the fields, the main one first. */
  fields: Array<string>,
  /** Notices to be shown with the data, one a line, as in the volume's description. */
  notice: string | null,
  /**
   * Name of the server that takes batch jobs and uploads, if there are several behind a proxy (`--job-server`); null: it is the one that
   * answers.
   */
  jobServer: string | null,
};
