//! From a view to a surface: the device's worker, what it keeps, budgets, simplification.

pub mod budget;
mod error;
mod residency;
pub mod simplification;
pub mod statistics;
mod worker;
mod worker_state;

pub use error::{UnknownStep, WorkError};
pub use worker::{DeviceState, DeviceWorker, Extraction, Plan, PrefixCount, QUEUED_JOBS, VolumeStep};
