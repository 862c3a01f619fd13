//! isopeel's algorithm on OpenCL: a volume goes in, a decimated isosurface comes out.
//!
//! In reading order:
//!
//! - [`device`]: lists OpenCL devices and selects one.
//! - [`volume`]: sample types, grids, and volumes resident on the device.
//! - [`transfer`], [`interest`], [`params`]: the user's parameters.
//! - [`engine`]: a device with its programs; loads volumes, builds pyramids, peels surfaces.
//! - [`Cut`]: the leaves of a pyramid.
//! - [`surface`]: the result, regions of indexed triangles.
//! - [`check`]: checks that a device computes correct results.
//! - [`error`]: the errors of the crate.
//! - [`synthetic`]: volumes generated from formulas, and the device's own speed, for benches.
//! - [`tuning`]: work-group sizes and other settings for a CPU and a GPU.
//! - [`layout`]: the structs that host and device exchange.
//! - `bulk`, [`interned`], `checked`: arrays, texts and conditions of types that are sent to another process.
//! - [`tables`]: the case tables of a cube.
//! - `testing`: access to internals for tests outside the crate, behind the feature of that name.
//!
//! This crate knows nothing of tokio, sockets, JSON or files.

mod activity;
mod buffer;
#[cfg(feature = "serde")]
pub mod bulk;
mod cancel;
pub mod check;
#[cfg(feature = "serde")]
mod checked;
mod constants;
mod context;
mod cut;
pub mod device;
#[cfg(test)]
mod device_tests;
pub mod engine;
pub mod error;
pub mod expression;
mod feature;
#[cfg(test)]
mod generated;
pub mod interest;
pub mod interned;
pub mod layout;
mod lock;
mod mask;
mod mesh_regions;
mod pace;
pub mod params;
mod program;
mod pyramid;
mod rectilinear;
mod shared_slice;
mod sources;
mod stages;
pub mod surface;
pub mod synthetic;
pub mod tables;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod transfer;
mod tree;
pub mod tuning;
pub mod volume;

pub use activity::Activity;
pub use buffer::DeviceMemory;
pub use cancel::{Cancel, Never, check_cancelled};
#[cfg(feature = "testing")]
pub use context::recorder;
pub use cut::Cut;
pub use device::{DeviceInfo, DeviceKind};
pub use engine::{
    Engine,
    cut::{Differences, Kept},
    fit::BUDGET_FIT,
    query::{CURVE_POINTS, DistributionCounts, MAX_BINS, Probed, ProbedLeaf, ProbedPart, ShownCut},
    tree_cut::TreeSurface,
    tree_refine::{RefinementCost, RegionVertex},
    upload::Upload,
    vertex_distances::DistanceOf,
    vertex_values::ValuesOf,
};
pub use error::{Error, Result};
pub use expression::Expression;
pub use feature::{DerivedFeature, Feature, Histogram, VectorFeature};
pub use interest::{Interest, InterestShape};
pub use lock::lock;
pub use mask::ValueSet;
pub use mesh_regions::{SPARSE_TRIANGLES, TreeRegions};
pub use params::{CutParams, Isovalue, Level, MAX_LEVEL, Mesher, Topology};
pub use program::{CompilerCheck, Gate};
pub use pyramid::Pyramid;
pub use rectilinear::RectilinearGrid;
pub use shared_slice::SharedSlice;
pub use sources::build_id;
pub use stages::histogram::HistogramWork;
pub use stages::overview::{Overview, OverviewMode, OverviewPart, OverviewValues, OverviewWork};
pub use surface::{
    Count, CurvePoint, ErrorEstimate, MeasuredError, Region, RegionKey, RemovedParts, StageTime, Surface, SurfaceError,
    SurfaceStatistics, Vertex,
};
pub use synthetic::{DeviceSpeed, Shape, Synthetic};
pub use transfer::{ControlPoint, TransferFunction};
pub use tree::{ChosenParts, PartFilter, RegionWeights, TreeGoal, VertexTree};
pub use tuning::Tuning;
pub use volume::{Grid, SampleType, Samples, Volume};

/// Cells per axis of a region, the unit of transport: the level-5 cube.
pub const REGION_CELLS: u32 = 32;
/// Cells per axis of a brick, the unit of activity: the level-3 cube.
pub const BRICK_CELLS: u32 = 8;
