//! From a view to a surface.
//!
//! - `worker`: the bounded queue to the thread that owns the device; `device_thread` opens the device, and reopens it after it was lost;
//!   `attempts` runs a job until it has a result; `worker_state` is the state of this thread: resident data, by `keys` and
//!   `identity`, in caches (`residency`; `cuts` that clients show), on `grids`. `scheduler` runs other jobs when a long job yields. `loader`
//!   brings fields onto the device, in `uploads`; `loading` is their progress.
//! - `pins`: volumes that must stay while jobs wait for them; `ahead` reads time steps before a viewer reaches them, beside those that
//!   viewers have open (`open_steps`).
//! - `memory`: memory by purpose; `shares`: limits of the caches for the next edits; `host_memory`: admission of allocations on the host;
//!   `host_space`: evictions that make space for them.
//! - `counting`: counts the triangles of a full surface before it is made.
//! - `questions`: queries on the current surface of a viewer.
//! - `histograms`: ranges and histograms, made a slice at a time between other jobs; `unfinished`: partial histograms, which their callers share.
//! - `slices`: planes of samples; `overviews`: volumes at a low resolution, in `overview_cache`.
//! - `refine`: steps from a surface that is shown to another one; `tree_steps`: intermediate, coarser cuts of the vertex tree;
//!   `chunk_bytes`: estimates of their bytes.
//! - `extractor`: budgets and limits on top; other layers extract through it. `byte_search` chooses its trials for a budget of bytes.
//! - `cube_cuts`, `tree_surfaces`: cuts of cubes and of the vertex tree for a view; `decisions`: chooses between them.
//! - `user_time`: the device's time that the computed fields of each user have taken.
//! - `intersections`: places at which triangles of a surface intersect, so that it is refined there.
//! - `results`, `statistics`, `volume_info`: results for other layers.

mod ahead;
mod attempts;
mod byte_search;
mod chunk_bytes;
mod computed;
mod counting;
mod cube_cuts;
mod cuts;
mod decisions;
mod device_thread;
mod error;
mod extractor;
mod feature_fields;
mod grids;
mod histograms;
mod host_memory;
mod host_space;
mod identity;
mod intersections;
mod keys;
mod loader;
mod loading;
mod lock;
mod memory;
mod observed;
mod open_steps;
mod overview_cache;
mod overviews;
mod pins;
mod questions;
mod refine;
mod release;
mod residency;
mod results;
mod scheduler;
mod shares;
mod slices;
mod statistics;
mod tree_steps;
mod tree_surfaces;
mod unfinished;
mod uploads;
mod user_time;
mod volume_info;
mod worker;
mod worker_state;

pub use device_thread::{Choice, Choose, DeviceOptions, DeviceState, NoChoice, Preparation, Report};
pub use error::{OpenError, WorkError};
pub use extractor::Extractor;
pub use host_memory::{limit_host_memory, return_freed_memory};
pub use identity::{EngineId, FittedKey, SurfaceKey, ViewKey};
pub use loading::{OpeningProgress, OpeningWatch};
pub use memory::MemoryUse;
pub use open_steps::Held;
pub use questions::{
    Answer, Curve, CurvePoint, Distribution, FieldValue, LeafKind, NearestLeaf, NearestSurface, NoValue, Probe,
    Question, ShownSurface, VertexErrors,
};
pub use results::{
    CutId, ExportWork, Extraction, FullCount, Measurement, Measuring, Refinement, Refining, Shown, Step,
};
pub use shares::PROCESSOR_BYTES;
pub use slices::Slice;
pub use statistics::{Cleaned, EstimatedError, ExtractionStatistics, MeasuredError, Shape};
pub use user_time::USER_TIME_PERIOD;
pub use volume_info::{
    AxisInfo, DerivedInfo, FieldInfo, GeometryInfo, HistogramInfo, LabelInfo, TimesInfo, VectorInfo, VolumeInfo,
    describe, describe_expression,
};
pub use worker::{DeviceWorker, QUEUED_JOBS};
