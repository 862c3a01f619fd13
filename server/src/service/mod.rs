//! The workspace of a device as a service: many callers share it, and wait for each other in a queue.
//!
//! The queue:
//! - `worker`: the bounded queue to the thread that owns the device.
//! - `device_thread`: opens the device, and reopens it after it was lost.
//! - `job`: a request in the queue. `attempts`: retries a request until it has a result.
//! - `scheduler`: the order of jobs. It runs other jobs when a long job pauses.
//! - `observed`: state for monitoring.
//!
//! Several devices:
//! - `device_pool`: the devices of a server, and which of them work on a volume. `assignment`: decides which devices have which datasets.
//!   `means`: measured times of a device.
//!
//! Fields:
//! - `loader`: reads fields and sends them to the device. `loading`: progress of the loads.
//! - `pins`: callers that wait until volumes can be pinned.
//! - `ahead`: reads time steps before a viewer reaches them.
//!
//! Results:
//! - `surfaces`: counts, steps, final surfaces and errors, within budgets and limits.
//! - `slices`: samples.
//! - `histograms` and `overviews`: made a slice at a time between other jobs. `unfinished` and `overview_cache`: their work, shared by
//!   callers.
//! - `volume_info`: the description of a volume.

mod ahead;
mod assignment;
mod attempts;
mod device_pool;
mod device_thread;
mod histograms;
mod job;
mod loader;
mod loading;
mod means;
mod observed;
mod overview_cache;
mod overviews;
mod pins;
pub mod process;
mod scheduler;
mod slices;
mod surfaces;
mod unfinished;
mod volume_info;
mod worker;

pub use device_pool::{DeviceError, DevicePool, Seat};
pub use device_thread::{Choice, ChoiceError, DeviceChooser, DeviceOptions, DeviceState, Preparation, StateReporter};
pub use job::TRACE;
pub use loading::{OpeningProgress, OpeningWatch};
pub use volume_info::{
    AxisInfo, DerivedInfo, FieldInfo, GeometryInfo, HistogramInfo, LabelInfo, TimesInfo, VectorInfo, VolumeInfo,
    describe, describe_expression,
};
pub use worker::{DeviceWorker, QUEUED_JOBS};
