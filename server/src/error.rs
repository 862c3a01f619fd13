//! Errors of any type, and their text with all causes.

use std::error::Error;

pub use isopeel_extraction::chain;

/// Any error. [`chain`] formats it with its causes.
pub type BoxError = Box<dyn Error + Send + Sync>;
