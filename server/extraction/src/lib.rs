//! The engine as a library: extracts surfaces from a volume and a view.
//!
//! A [`Workspace`] holds a device, the fields that are resident on it, and cached data of earlier edits. It may move to another thread.
//! Each piece of work ends with a result or a [`JobError`], which says what to do before the work is retried, such as loading fields. A
//! server does so between other work; [`Workspace::run_to_completion`] does so at once, for programs that have the device for themselves.
//!
//! - Workspace: `workspace` holds the resident data in caches (`residency`, `cuts`, `histogram_cache`) by keys (`keys`, `identity`).
//!   `context`: cancellation and pauses of a piece of work. `job_error`, `error`: its errors. `observer`: counters and timers. `complete`
//!   runs work and loads what it needs. `user_time`: device time that the computed fields of each user have taken.
//! - `requests`: requests of a server to a workspace, as data.
//! - Fields: `reading` reads them, `uploads` sends them to the device, on `grids`; `ahead` does so for time steps that a viewer may reach
//!   next; `release` frees those of a time step. `pins`: fields that must stay resident. `open_steps`: time steps that viewers have open.
//!   `computed` and `fields` compute fields from others, on the device and on the host. `dataset_views`: the initial view of a dataset.
//! - Memory: `memory`: use by purpose; `shares`: limits of the caches; `host_memory`: admission of allocations on the host; `host_space`:
//!   evictions that make space for them.
//! - Cuts: `cube_cuts` and `tree_surfaces` cut cubes and the vertex tree for a view; `decisions`: the outcome if an error or a budget
//!   decides. `byte_search` fits a budget of bytes. `intersections`: places at which a surface is refined.
//! - Surfaces: `on_device`: a view on the device, with its feature (`feature_fields`). `final_surfaces`: its surface and error. `refine`
//!   and `tree_steps`: steps from the shown surface to the final one, within limits on bytes that `chunk_bytes` estimates. `results`,
//!   `statistics`: results. `joined`: a surface as one mesh.
//! - Queries: `counting`: the triangles of a full surface, before it is made. `questions`: queries on a surface. `histograms`: ranges and
//!   histograms. `overviews`: fields at a low resolution. `slices`: planes of samples.
//!
//! A whole program:
//!
//! ```no_run
#![doc = include_str!("../examples/surface.rs")]
//! ```

mod ahead;
mod byte_search;
mod camera;
mod chunk_bytes;
mod complete;
mod computed;
mod context;
mod counting;
mod cube_cuts;
mod cuts;
pub mod dataset_views;
mod decisions;
mod error;
mod feature_fields;
pub mod fields;
mod final_surfaces;
mod grids;
mod histogram_cache;
mod histograms;
mod host_memory;
mod host_space;
mod identity;
mod intersections;
mod job_error;
mod joined;
mod keys;
mod memory;
mod observer;
mod on_device;
mod open_steps;
mod overviews;
mod pins;
mod questions;
mod reading;
mod refine;
mod release;
mod requests;
mod residency;
mod results;
mod shares;
mod slices;
mod statistics;
mod tree_steps;
mod tree_surfaces;
mod uploads;
mod user_time;
mod workspace;

pub use byte_search::{ByteSearch, Trial};
pub use context::{JobContext, JobTimes, WaitingWork};
pub use error::{OpenError, WorkError, chain};
pub use grids::padded_grid;
pub use histogram_cache::HistogramCache;
pub use host_memory::{HostMemory, host_memory_limit, limit_host_memory, trim_heaps};
pub use identity::{EngineId, FittedKey, SurfaceKey, ViewKey};
pub use isopeel_kernels::lock;
pub use job_error::JobError;
pub use joined::{JoinError, Joined, WorldMesh};
pub use keys::{ALWAYS_DESCRIBED, HistogramKey, Masking, VolumeKey, view_keys, with_inputs};
pub use memory::{
    CountedProcess, MemoryUse, WorkspaceMemory, count_further_bytes, counted_bytes, private_bytes, resident_bytes,
};
pub use observer::Observer;
pub use open_steps::{OpenStepGuard, OpenSteps};
pub use pins::{Pinned, Pins};
pub use questions::{
    Answer, Curve, CurvePoint, Distribution, FieldValue, LeafKind, NearestLeaf, NearestSurface, NoValue, Probe,
    Question, ShownSurface, VertexErrors,
};
pub use reading::{Piece, bytes_while_read, read};
pub use requests::{
    Ask, BeginUpload, CheckAnswers, Compute, ContinueHistogram, ContinueOverview, ContinueTable, ContinueUpload, Count,
    DeviceReply, DeviceRequest, DropUpload, Extract, FindResident, FinishUpload, Improve, MakeHostSpace,
    MakeSpaceAhead, Measure, Prepare, ReadSamples, ReadSlice, Refine, Release, Request, Resolve, UseField,
    UseHistogramFields, VolumeRequest,
};
pub use residency::Lru;
pub use results::{
    CutId, ExportWork, Extraction, FullCount, Making, Measurement, Measuring, Refinement, Refining, Shown, Step,
    number_from,
};
pub use shares::PROCESSOR_BYTES;
pub use slices::Slice;
pub use statistics::{Cleaned, EstimatedError, ExtractionStatistics, MeasuredError, Shape};
pub use user_time::{USER_TIME_PERIOD, UserTimes};
pub use workspace::{Options, Workspace};
