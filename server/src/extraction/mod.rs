//! From a view to a surface: the device's worker, what it keeps, budgets, simplification.

mod error;
mod extractor;
mod residency;
pub mod simplification;
mod statistics;
mod volume_info;
mod worker;
mod worker_state;

pub use error::{UnknownStep, WorkError};
pub use extractor::{EncodedBytes, Extractor};
pub use statistics::{ExtractionStatistics, StatedError};
pub use volume_info::{DerivedInfo, FieldInfo, GeometryInfo, HistogramInfo, VolumeInfo, describe};
pub use worker::{DeviceState, DeviceWorker, Extraction, Plan, PrefixCount, QUEUED_JOBS, VolumeStep};
