/**
 * Everything that crosses the wire as JSON, in one file. Normative: `server/PROTOCOL.md` for the stream,
 * `/api/v1/openapi.json` for REST.
 */

/** Three numbers: x, y, z. */
export type Vec3 = readonly [number, number, number];

/** One control point of a transfer function; importance is linear between points, constant beyond the ends. */
export interface ControlPoint {
  /** Where on the blended feature, 0 to 1. */
  readonly x: number;
  /** Importance there, 0 to 1. */
  readonly importance: number;
  /** Colour there, `#rrggbb`. */
  readonly color: string;
}

/** Importance and colour over the blended feature; 1 to 64 points, sorted by x. */
export interface TransferFunction {
  readonly points: readonly ControlPoint[];
}

/** Every value in force, as `opened` states it. */
export interface View {
  /** Isovalue, in the field's units. */
  readonly iso: number;
  /** Field whose isosurface is shown. */
  readonly field: string;
  /** A field's name, `gradient-magnitude` or `none`. */
  readonly feature: string;
  /** Feature values that become 0 and 1, in the feature's units. `undefined` (not sent): the feature's own range. */
  readonly featureRange: readonly [number, number] | undefined;
  /** Weight of the feature against smoothness, 0 to 1. */
  readonly alpha: number;
  /** Importance up to which a cube is decimated; below 0: the full surface. `undefined`: a budget decides. */
  readonly beta: number | undefined;
  /** Budget: the most triangles. */
  readonly triangles: number | undefined;
  /** Budget: the most bytes on the wire. */
  readonly bytes: number | undefined;
  /** Guard: world units, text like `0.25vx` (multiples of the smallest spacing), or null for none. */
  readonly maxError: number | string | null;
  /** Guard: whether decimation may change the topology. */
  readonly topology: "preserve" | "free";
  readonly mesher: "dual" | "marching-cubes";
  /** Whether the final surface is simplified once more. */
  readonly polish: boolean;
  /** Coarsest level, 0 to 5. */
  readonly maxLevel: number;
  readonly transferFunction: TransferFunction;
}

/** What changes; the rest keeps its value. */
export type Edit = Partial<View>;

/** Where the samples lie: `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`. */
interface Geometry {
  /** Samples along x, y, z. */
  readonly dims: Vec3;
  /** World units between samples. */
  readonly spacing: Vec3;
  /** World position of sample (0, 0, 0). */
  readonly origin: Vec3;
  /** Unit vectors of the axes x, y, z in the world. */
  readonly direction: readonly [Vec3, Vec3, Vec3];
}

/** How often values occur: equal bins over the range. */
export interface Histogram {
  readonly min: number;
  readonly max: number;
  readonly counts: readonly number[];
}

/** One field of a volume, or a feature derived from one. */
export interface FieldInfo {
  readonly name: string;
  /** Type on the device: `u8`, `i8`, `u16`, `i16` or `f32`. */
  readonly type: string;
  readonly unit: string | null;
  /** Smallest and largest value. */
  readonly range: readonly [number, number];
  readonly histogram: Histogram;
  /** Magnitude of its gradient, the feature `gradient-magnitude` of this field; absent where this is a feature. */
  readonly gradientMagnitude?: DerivedInfo;
}

/** A feature computed from a field. */
export interface DerivedInfo {
  readonly unit: string | null;
  /** Smallest and largest value. */
  readonly range: readonly [number, number];
  readonly histogram: Histogram;
}

/** An entry of `GET /api/v1/volumes`. */
export interface VolumeSummary {
  readonly id: string;
  readonly title: string;
  /** Samples along x, y, z. */
  readonly dims: Vec3;
  readonly steps: number;
  /** Names, the main one first. */
  readonly fields: readonly string[];
  /** Copyright or source to show beside the data. */
  readonly notice: string | null;
}

/** `GET /api/v1/volumes/{id}`, and `volume` of `opened`. */
export interface VolumeInfo {
  readonly id: string;
  readonly title: string;
  readonly geometry: Geometry;
  /** Time steps, at least 1. */
  readonly steps: number;
  /** The main one first. */
  readonly fields: readonly FieldInfo[];
  /** Features besides `none`: `gradient-magnitude` (described with each field), then the fields. */
  readonly features: readonly FieldInfo[];
  /** Copyright or source to show beside the data. */
  readonly notice: string | null;
}

/** As `isopeel extract --stats` prints them. */
export interface Statistics {
  readonly mesher: string;
  /** As given, or as found for a budget. */
  readonly beta: number;
  /** Guard on the error, world units. */
  readonly max_error: number | null;
  readonly topology: string;
  readonly polished: boolean;
  /** Distance from the surface it stands for, world units; null: not stated. */
  readonly error: { readonly rms: number; readonly max: number } | null;
  readonly full_triangles: number;
  readonly active_cells: number;
  /** Leaves of the cut, level 0 first. */
  readonly leaves: readonly number[];
  readonly triangles: number;
  readonly vertices: number;
  readonly lost_cubes: number;
  readonly unpatched_vertices: number;
  /** Device time by stage, in milliseconds. */
  readonly stages_ms: Readonly<Record<string, number>>;
  readonly wall_ms: number;
  readonly device_bytes: number;
  readonly volume_bytes: number;
  readonly device: string;
}

export type ClientMessage =
  | { readonly type: "open"; readonly volume: string; readonly step: number }
  | ({ readonly type: "edit" } & Edit)
  | { readonly type: "cancel" }
  | { readonly type: "drawn"; readonly generation: number };

export type ServerMessage =
  | { readonly type: "opened"; readonly volume: VolumeInfo; readonly step: number; readonly edit: View; readonly device: string }
  | {
      readonly type: "prefix";
      readonly generation: number;
      readonly level: number;
      /** Chunks that follow. */
      readonly regions: number;
      /** Earlier regions that stay as they are. */
      readonly standing: number;
    }
  | { readonly type: "committed"; readonly generation: number; readonly level: number }
  | { readonly type: "done"; readonly generation: number; readonly statistics: Statistics }
  | { readonly type: "superseded"; readonly generation: number }
  | { readonly type: "error"; readonly code: string; readonly message: string; readonly open: boolean };

/** Levels are 0 (finest) to 5. */
export const LEVELS = 6;
/** Cells along a region's edge. */
export const REGION_CELLS = 32;
export const SUBPROTOCOL = "isopeel.v1";
export const MAX_POINTS = 64;
