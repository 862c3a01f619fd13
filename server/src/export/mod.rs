//! Surfaces as files: GLB (glTF 2.0), PLY, STL and VTP. Each names the frame and the unit of its positions, and the volume's notices.
//!
//! [`FileRequest`] is what is asked for, [`MadeFile`] what is made of it. [`mesh`] joins the regions of a surface into one mesh; [`glb`], [`ply`], [`stl`] and [`vtp`] stream it to a [`Write`]r. By hand: each writer is
//! shorter than the conversion to a library's own mesh would be, and never holds the file in memory.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use crate::extraction::ExtractionStatistics;
use crate::view::Edit;
use crate::volumes::{LengthUnit, VolumeStep};

mod empty;
mod field_values;
pub mod glb;
mod label;
mod made;
pub mod mesh;
pub mod ply;
mod request;
pub mod stl;
mod topology;
mod transform;
pub mod vtp;

pub(crate) use empty::why_empty;
pub(crate) use made::safe_name;
pub use made::{MadeFile, MakeError, make};
pub use mesh::Mesh;
pub(crate) use request::merged_schema;
pub use request::{FileOptions, FileRequest};

// Arrays are written as they are in memory, and all formats are little-endian.
const _: () = assert!(
    cfg!(target_endian = "little"),
    "isopeel's exports need a little-endian machine"
);

/// File format of an exported surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Binary glTF 2.0, in metres and Y up, with smoothness and feature as vertex attributes.
    Glb,
    /// Binary little-endian PLY, with smoothness and feature a vertex.
    Ply,
    /// Binary STL: triangles alone.
    Stl,
    /// VTK's XML `PolyData`, with smoothness and feature a point and the level a triangle.
    Vtp,
}

impl Format {
    /// The names of all, for people.
    pub const EXPECTED: &str = "glb, ply, stl or vtp";

    /// The format of a file name's extension.
    ///
    /// # Errors
    /// [`ExportError::UnknownExtension`].
    pub fn from_path(path: &Path) -> Result<Self, ExportError> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        match extension.to_ascii_lowercase().as_str() {
            "glb" => Ok(Self::Glb),
            "ply" => Ok(Self::Ply),
            "stl" => Ok(Self::Stl),
            "vtp" => Ok(Self::Vtp),
            _ => Err(ExportError::UnknownExtension(path.display().to_string())),
        }
    }

    /// Extension without the dot.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Ply => "ply",
            Self::Stl => "stl",
            Self::Vtp => "vtp",
        }
    }

    /// About how many bytes a closed surface takes, which has half as many vertices as triangles.
    pub const fn typical_bytes(self, triangles: u64) -> u64 {
        let per_triangle = match self {
            // Vertices of 42 bytes (position, normal, two features, colour), three indices of 4.
            Self::Glb => 33,
            // Vertices of 44 bytes; a count and three indices of 4.
            Self::Ply => 35,
            // Normal, corners, two bytes.
            Self::Stl => 50,
            // As PLY, with a level and four indices of 8.
            Self::Vtp => 55,
        };
        triangles.saturating_mul(per_triangle)
    }

    /// Media type for HTTP.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            // No media type is registered for these.
            Self::Ply | Self::Vtp => "application/octet-stream",
            Self::Stl => "model/stl",
        }
    }
}

/// Why a surface could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The name does not say the format.
    #[error("{0:?} does not say the format: expected a name that ends in .glb, .ply, .stl or .vtp")]
    UnknownExtension(String),
    /// More than the format or its 32-bit numbers can hold.
    #[error("{what}: {found}, {format} allows {limit}")]
    TooLarge {
        /// What is too large, with its unit.
        what: &'static str,
        /// Its size.
        found: u64,
        /// Its maximum.
        limit: u64,
        /// The format with this limit.
        format: &'static str,
    },
    /// World coordinates do not fit the numbers of the format.
    #[error("a vertex lies at {0:?} world units, beyond what the numbers of the format hold")]
    OutOfRange([f64; 3]),
    /// A region that is not consistent.
    #[error("region {region:?}: {why}")]
    BadRegion {
        /// The region.
        region: [u32; 3],
        /// What was found and what was expected.
        why: String,
    },
    /// Nobody waits for it any more.
    #[error("cancelled")]
    Cancelled,
    /// Writing failed.
    #[error("the surface could not be written")]
    Io(#[from] io::Error),
}

/// Writes `mesh` as `format`. `extras` goes into a GLB, under `asset.extras`; the other formats have no field for it.
///
/// # Errors
/// What the format cannot hold, or the errors of `out`.
pub fn write(mesh: &Mesh, format: Format, extras: &serde_json::Value, out: &mut impl Write) -> Result<(), ExportError> {
    match format {
        Format::Glb => glb::write(mesh, extras, out),
        Format::Ply => ply::write(mesh, out),
        Format::Stl => stl::write(mesh, out),
        Format::Vtp => Ok(vtp::write(mesh, out)?),
    }
}

/// What a GLB says about itself: volume, step, every value in force, statistics, notices; frame and unit of its positions, before the
/// node turns them. Equal for equal requests: times and memory are left out.
pub fn extras(volume: &VolumeStep, edit: &Edit, statistics: &ExtractionStatistics) -> serde_json::Value {
    let dataset = volume.dataset();
    serde_json::json!({
        "volume": dataset.id,
        "step": volume.step(),
        "frame": dataset.geometry.frame.name(),
        "unit": dataset.geometry.unit.map(LengthUnit::symbol),
        "notice": dataset.notice(),
        "view": edit,
        "statistics": statistics.of_surface(),
    })
}

/// What a file is, before it is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileDigest {
    /// Its length.
    pub bytes: u64,
    /// XXH3 of all of it.
    pub hash: u128,
}

/// Returns length and hash of what [`write`] writes.
///
/// # Errors
/// What the format cannot hold; [`write`] then fails only if `out` does. [`ExportError::Io`] if it is cancelled.
pub fn digest(
    mesh: &Mesh,
    format: Format,
    extras: &serde_json::Value,
    is_cancelled: &dyn Fn() -> bool,
) -> Result<FileDigest, ExportError> {
    let digester = Digester {
        bytes: 0,
        hasher: Xxh3::new(),
        is_cancelled,
    };
    let mut out = BufWriter::with_capacity(DIGEST_BUFFER_BYTES, digester);
    write(mesh, format, extras, &mut out)?;
    let Digester { bytes, hasher, .. } = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    let hash = hasher.digest128();
    Ok(FileDigest { bytes, hash })
}

/// Bytes that are hashed at once.
const DIGEST_BUFFER_BYTES: usize = 1 << 16;

/// Counts and hashes bytes, and drops them.
struct Digester<'a> {
    bytes: u64,
    hasher: Xxh3,
    is_cancelled: &'a dyn Fn() -> bool,
}

impl Write for Digester<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if (self.is_cancelled)() {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        self.bytes += bytes.len() as u64;
        self.hasher.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Checks that `found` fits the format's 32-bit counter.
fn fits_u32(what: &'static str, found: u64, format: &'static str) -> Result<u32, ExportError> {
    u32::try_from(found).map_err(|_| ExportError::TooLarge {
        what,
        found,
        limit: u64::from(u32::MAX),
        format,
    })
}
