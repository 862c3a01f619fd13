//! Where data comes from: one reader a format, and the catalog that names them.
//!
//! A reader opens a path in two steps: the header becomes [`Field`] descriptions without touching the samples,
//! [`Field::load`] reads one time step of one field. What is wrong with a file is said with [`ReadError`].

use std::path::PathBuf;

pub use isopeel_kernels::Samples;

/// A dataset: fields that share one grid.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Stable name in URLs: `[a-z0-9-]+`, unique in the catalog.
    pub id: String,
    /// Name for people.
    pub title: String,
    /// Grid that all fields share.
    pub geometry: Geometry,
    /// Time steps, at least 1.
    pub steps: u32,
    /// Fields, the main one first.
    pub fields: Vec<Field>,
    /// Copyright or source to show beside the data, when there is one.
    pub notice: Option<String>,
    /// What the viewer opens with; `None` where nothing better than the defaults is known.
    pub opening: Option<crate::edit::Edit>,
}

/// Where the samples lie in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Samples along x (fastest), y, z; at least 2 each.
    pub dims: [u32; 3],
    /// World units between samples; finite, above 0.
    pub spacing: [f64; 3],
    /// World position of sample (0, 0, 0).
    pub origin: [f64; 3],
    /// Unit vectors of the axes x, y, z in the world, as columns: `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`.
    pub direction: [[f64; 3]; 3],
}

/// One field of a dataset.
#[derive(Clone, Debug)]
pub struct Field {
    /// Name, unique in its dataset: the file's stem, or the name inside the file.
    pub name: String,
    /// Type of the samples in the file, as the format names it.
    pub stored_type: String,
    /// Type on the device.
    pub sample_type: isopeel_kernels::SampleType,
    /// Value that means "no sample here", where the file declares one.
    pub missing: Option<f32>,
    /// Unit of the values, where the file declares one.
    pub unit: Option<String>,
    /// How to get at the samples.
    pub source: std::sync::Arc<dyn Source>,
}

/// Reads samples of one field.
pub trait Source: Send + Sync + std::fmt::Debug {
    /// Reads one time step, x fastest, exactly `dims` samples.
    ///
    /// # Errors
    /// What is wrong with the file.
    fn load(&self, step: u32) -> Result<Samples, ReadError>;
}

/// What is wrong with a file: which one, which part of it, what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{}: {field}: {why}", path.display())]
pub struct ReadError {
    /// File at fault.
    pub path: PathBuf,
    /// Field of its header, or `data`.
    pub field: String,
    /// What was found and what was expected.
    pub why: String,
    /// Cause, where another error is behind it.
    #[source]
    pub source: Option<std::io::Error>,
}
