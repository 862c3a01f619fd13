//! From a volume and a view to a surface: the engine as a library.
//!
//! A [`Workspace`] holds a device, the fields that are resident on it, and what earlier edits have made. It belongs to one thread. Each
//! piece of work ends with a result or a [`JobError`]: what has to be done before it is tried again, such as loading fields. A server does
//! that between other work; [`Workspace::run_to_completion`] does it at once, for programs that have the device for themselves.
//!
//! - `workspace`: resident data, by `keys` and `identity`, in caches (`residency`; `cuts` that clients show; `histogram_cache`), on `grids`.
//!   `context`: the caller of a piece of work; `job_error`, `error`: why it has no result. `observer`: counters and timers.
//! - `reading` reads fields, `uploads` sends them to the device; `ahead` does so for time steps that a viewer may reach next; `release` frees
//!   a time step. `computed`, `fields`: fields that are computed from others, on the device and on the host. `pins`: volumes that must stay.
//!   `complete`: work with all that it needs.
//! - `memory`: memory by purpose; `shares`: limits of the caches for the next edits; `host_memory`: admission of allocations on the host;
//!   `host_space`: evictions that make space for them.
//! - `counting`: the triangles of a full surface, before it is made. `questions`: queries on a surface. `histograms`: ranges and histograms;
//!   `overviews`: volumes at a low resolution; `slices`: planes of samples.
//! - `on_device`: a view on the device. `final_surfaces`: its surface and error; `refine`: steps from a surface that is shown to another one; `tree_steps`: intermediate, coarser cuts of the vertex tree;
//!   `chunk_bytes`: estimates of their bytes. `byte_search` chooses trials for a budget of bytes.
//! - `cube_cuts`, `tree_surfaces`: cuts of cubes and of the vertex tree for a view; `decisions`: chooses between them. `feature_fields`: a
//!   feature with its fields. `intersections`: places at which triangles of a surface intersect, so that it is refined there.
//! - `dataset_views`: what a dataset is to a view. `user_time`: device time that the computed fields of each user have taken.
//! - `results`, `statistics`: results. `joined`: a surface as one mesh.
//!
//! A whole program:
//!
//! ```no_run
#![doc = include_str!("../examples/surface.rs")]
//! ```

mod ahead;
mod byte_search;
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
mod lock;
mod memory;
mod observer;
mod on_device;
mod overviews;
mod pins;
mod questions;
mod reading;
mod refine;
mod release;
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
pub use host_memory::{HostMemory, limit_host_memory, trim_heaps};
pub use identity::{EngineId, FittedKey, SurfaceKey, ViewKey};
pub use job_error::JobError;
pub use joined::{JoinError, Joined, WorldMesh, join};
pub use keys::{ALWAYS_DESCRIBED, HistogramKey, Masking, VolumeKey, view_keys, with_inputs};
pub use lock::lock;
pub use memory::{MemoryUse, WorkspaceMemory, resident_bytes};
pub use observer::Observer;
pub use pins::{Pinned, Pins};
pub use questions::{
    Answer, Curve, CurvePoint, Distribution, FieldValue, LeafKind, NearestLeaf, NearestSurface, NoValue, Probe,
    Question, ShownSurface, VertexErrors,
};
pub use reading::{Piece, bytes_while_read, read};
pub use residency::Lru;
pub use results::{
    CutId, ExportWork, Extraction, FullCount, Making, Measurement, Measuring, Refinement, Refining, Shown, Step,
};
pub use shares::PROCESSOR_BYTES;
pub use slices::Slice;
pub use statistics::{Cleaned, EstimatedError, ExtractionStatistics, MeasuredError, Shape};
pub use user_time::{Payer, USER_TIME_PERIOD, UserTimes};
pub use workspace::{Options, Workspace};
