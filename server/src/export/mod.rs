//! Surfaces as files: GLB (glTF 2.0), PLY and STL, all in world units.
//!
//! In reading order: [`mesh`] joins the regions of a surface into one mesh; [`glb`], [`ply`] and [`stl`] each write
//! one format to any [`Write`]r, never holding the file in memory.

use std::io::{self, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::extraction::ExtractionStatistics;
use crate::view::Edit;

pub mod glb;
pub mod mesh;
pub mod ply;
pub mod stl;

pub use mesh::Mesh;

// The writers hand arrays to the file as they lie in memory; every format here is little-endian.
const _: () = assert!(
    cfg!(target_endian = "little"),
    "isopeel's exports need a little-endian machine"
);

/// File format of an exported surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Binary glTF 2.0, one primitive a level, with smoothness and feature as vertex attributes.
    Glb,
    /// Binary little-endian PLY, with smoothness and feature a vertex and the level a face.
    Ply,
    /// Binary STL: triangles alone.
    Stl,
}

impl Format {
    /// The format that a file name's extension stands for.
    ///
    /// # Errors
    /// [`ExportError::UnknownExtension`].
    pub fn from_path(path: &Path) -> Result<Self, ExportError> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        match extension.to_ascii_lowercase().as_str() {
            "glb" => Ok(Self::Glb),
            "ply" => Ok(Self::Ply),
            "stl" => Ok(Self::Stl),
            _ => Err(ExportError::UnknownExtension(path.display().to_string())),
        }
    }

    /// Extension without the dot.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Ply => "ply",
            Self::Stl => "stl",
        }
    }

    /// Media type for HTTP.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            // No media type is registered for PLY.
            Self::Ply => "application/octet-stream",
            Self::Stl => "model/stl",
        }
    }
}

/// Why a surface could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The name says nothing about the format.
    #[error("{0:?} does not say the format: expected a name that ends in .glb, .ply or .stl")]
    UnknownExtension(String),
    /// The format or its 32-bit numbers cannot hold so much.
    #[error("{what}: {found}, {format} allows {limit}")]
    TooLarge {
        /// What there is too much of, with its unit.
        what: &'static str,
        /// How much there is.
        found: u64,
        /// The most there may be.
        limit: u64,
        /// Who says so.
        format: &'static str,
    },
    /// World coordinates do not fit 32-bit floats.
    #[error("a vertex lies at {0:?} world units, beyond what 32-bit floats hold")]
    OutOfRange([f64; 3]),
    /// A surface that breaks its own promises.
    #[error("region {region:?}: {why}")]
    BadRegion {
        /// Region at fault.
        region: [u32; 3],
        /// What was found and what was expected.
        why: String,
    },
    /// Writing failed.
    #[error("the surface could not be written")]
    Io(#[from] io::Error),
}

/// Writes `mesh` as `format`. `extras` goes where the format has a place for it: in a GLB under `asset.extras`.
///
/// # Errors
/// What the format cannot hold, or what `out` says.
pub fn write(mesh: &Mesh, format: Format, extras: &serde_json::Value, out: &mut impl Write) -> Result<(), ExportError> {
    match format {
        Format::Glb => glb::write(mesh, extras, out),
        Format::Ply => ply::write(mesh, out),
        Format::Stl => stl::write(mesh, out),
    }
}

/// What a GLB says of itself: volume, step, every value in force, statistics.
pub fn extras(volume: &str, step: u32, edit: &Edit, statistics: &ExtractionStatistics) -> serde_json::Value {
    serde_json::json!({ "volume": volume, "step": step, "view": edit, "statistics": statistics })
}

/// Bytes that [`write`] will write.
///
/// # Errors
/// What the format cannot hold: after this, only `out` can fail.
pub fn length(mesh: &Mesh, format: Format, extras: &serde_json::Value) -> Result<u64, ExportError> {
    let mut counter = Counter(0);
    write(mesh, format, extras, &mut counter)?;
    Ok(counter.0)
}

/// Counts bytes and drops them.
struct Counter(u64);

impl Write for Counter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Checks that `found` fits what the format's 32-bit counter holds.
fn fits_u32(what: &'static str, found: u64, format: &'static str) -> Result<u32, ExportError> {
    u32::try_from(found).map_err(|_| ExportError::TooLarge {
        what,
        found,
        limit: u64::from(u32::MAX),
        format,
    })
}
