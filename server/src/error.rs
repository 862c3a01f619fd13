//! Errors of any kind, and how they are printed.

use std::error::Error;

pub use isopeel_extraction::chain;

/// Any error; [`chain`] prints it with its causes.
pub type BoxError = Box<dyn Error + Send + Sync>;
