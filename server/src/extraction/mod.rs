//! From a view to a surface: the device's worker, what it keeps, budgets, simplification.

mod error;
mod extractor;
mod keys;
mod residency;
mod results;
pub mod simplification;
mod statistics;
mod volume_info;
mod worker;
mod worker_state;

pub use error::WorkError;
pub use extractor::{EncodedBytes, Extractor};
pub use results::{Extraction, Plan, PrefixCount};
pub use statistics::{ExtractionStatistics, StatedError};
pub use volume_info::{DerivedInfo, FieldInfo, GeometryInfo, HistogramInfo, VolumeInfo, describe};
pub use worker::{DeviceState, DeviceWorker, QUEUED_JOBS};
