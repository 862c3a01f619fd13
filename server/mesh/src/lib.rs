//! Converts a surface to one mesh, and writes meshes as files.
//!
//! [`Mesh`] joins the regions of a surface to one mesh in the world. [`topology`] splits vertices at which sheets touch. [`clean`] moves
//! vertices so that no triangles intersect, and keeps vertices of a cap on its face ([`caps`]). [`Content`] writes meshes in one of nine
//! formats. Each file states the frame and the unit of its positions, and the notices of the volume.
//!
//! This crate has its own writers instead of libraries. A writer is shorter than a conversion to the mesh type of a library, and does not
//! hold the file in memory, unless the file is compressed.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use isopeel_extraction::JoinError;
use isopeel_volumes::LengthUnit;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

pub mod caps;
pub mod clean;
mod decimal;
mod gifti;
pub mod glb;
pub mod mesh;
mod obj;
mod ply;
mod precomputed;
mod rows;
pub mod stl;
mod three_mf;
pub mod topology;
mod transform;
mod usda;
mod usdz;
mod vtp;
pub mod xml;

pub use mesh::Mesh;

// The writers copy arrays from memory, and all binary formats here are little-endian.
const _: () = assert!(
    cfg!(target_endian = "little"),
    "isopeel's exports need a little-endian machine"
);

/// File format of an exported surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
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
    /// Wavefront OBJ: text, with normals and colours; several surfaces are objects.
    Obj,
    /// 3MF, in millimetres, with names and colours; several surfaces are objects.
    #[serde(rename = "3mf")]
    #[cfg_attr(feature = "clap", value(name = "3mf"))]
    ThreeMf,
    /// GIFTI, `.surf.gii`, in millimetres and the axes of NIfTI.
    Gifti,
    /// Neuroglancer's single-resolution meshes in a ZIP, in nanometres; several surfaces are segments.
    Precomputed,
    /// USDZ: a stage of Universal Scene Description with Y up, with names, materials and colours; several surfaces are meshes.
    Usdz,
}

/// How a file is compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Compress {
    /// As little as the format asks for.
    #[default]
    None,
    /// Arrays of a VTP as blocks of zlib; the text of a 3MF by deflate, to a third of its bytes.
    Zlib,
    /// A GLB with meshoptimizer's codecs and numbers of fewer bits, for pages on the web. Blender does not read it.
    Meshopt,
}

impl Compress {
    /// Whether no compression was requested.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    /// Returns the name in JSON and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Zlib => "zlib",
            Self::Meshopt => "meshopt",
        }
    }

    /// Whether this compression applies to files of a format.
    pub const fn applies_to(self, format: Format) -> bool {
        match self {
            Self::None => true,
            Self::Zlib => matches!(format, Format::Vtp | Format::ThreeMf),
            Self::Meshopt => matches!(format, Format::Glb),
        }
    }

    /// Returns the formats to which this compression applies, for error messages.
    pub const fn expected(self) -> &'static str {
        match self {
            Self::None => "any format",
            Self::Zlib => "a VTP or 3MF",
            Self::Meshopt => "a GLB",
        }
    }
}

impl Format {
    /// Names of all formats, for error messages.
    pub const EXPECTED: &str = "glb, ply, stl, vtp, obj, 3mf, gifti, precomputed or usdz";

    /// Suffixes of file names, and the formats that they imply.
    const ENDINGS: [(&str, Self); 10] = [
        (".glb", Self::Glb),
        (".ply", Self::Ply),
        (".stl", Self::Stl),
        (".vtp", Self::Vtp),
        (".obj", Self::Obj),
        (".3mf", Self::ThreeMf),
        (".surf.gii", Self::Gifti),
        (".gii", Self::Gifti),
        (".precomputed.zip", Self::Precomputed),
        (".usdz", Self::Usdz),
    ];

    /// Returns the format that a file's name implies.
    ///
    /// # Errors
    /// [`ExportError::UnknownExtension`].
    pub fn from_path(path: &Path) -> Result<Self, ExportError> {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase();
        let entry = Self::ENDINGS.iter().find(|(ending, _)| name.ends_with(ending));
        let unknown = || ExportError::UnknownExtension(path.display().to_string());
        entry.map(|&(_, format)| format).ok_or_else(unknown)
    }

    /// Returns the name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ThreeMf => "3mf",
            Self::Gifti => "gifti",
            Self::Precomputed => "precomputed",
            other => other.extension(),
        }
    }

    /// Returns the name for messages to users.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Glb => "GLB",
            Self::Ply => "PLY",
            Self::Stl => "STL",
            Self::Vtp => "VTP",
            Self::Obj => "OBJ",
            Self::ThreeMf => "3MF",
            Self::Gifti => "GIFTI",
            Self::Precomputed => "precomputed",
            Self::Usdz => "USDZ",
        }
    }

    /// Returns the file extension without its first dot.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Ply => "ply",
            Self::Stl => "stl",
            Self::Vtp => "vtp",
            Self::Obj => "obj",
            Self::ThreeMf => "3mf",
            Self::Gifti => "surf.gii",
            Self::Precomputed => "precomputed.zip",
            Self::Usdz => "usdz",
        }
    }

    /// Estimates the bytes of a file with a closed surface and the values of `fields` fields. Such a surface has half as many vertices as
    /// triangles.
    pub const fn typical_bytes(self, triangles: u64, fields: u64) -> u64 {
        let per_triangle = match self {
            // Vertices of 42 bytes (position, normal, two features, colour), three indices of 4.
            Self::Glb => 33,
            // Vertices of 44 bytes; a count and three indices of 4.
            Self::Ply => 35,
            // Normal, corners, two bytes.
            Self::Stl => 50,
            // Vertices as in PLY; a level and four indices of 4.
            Self::Vtp => 39,
            // Lines of some 60 bytes a vertex, and of 50 a triangle.
            Self::Obj => 80,
            // Elements of some 55 bytes a vertex, and of 55 a triangle.
            Self::ThreeMf => 80,
            // Vertices of 12 bytes, three indices of 4.
            Self::Gifti | Self::Precomputed => 18,
            // Text of some 65 bytes a vertex, and of 30 a triangle.
            Self::Usdz => 65,
        };
        let per_value = match self {
            Self::Glb | Self::Ply | Self::Vtp => 4,
            // Text of some 12 bytes.
            Self::Usdz => 12,
            _ => 0,
        };
        triangles.saturating_mul(per_triangle + fields * per_value / 2)
    }

    /// Returns the media type for HTTP.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            // No media type is registered for these formats.
            Self::Ply | Self::Vtp | Self::Gifti => "application/octet-stream",
            Self::Stl => "model/stl",
            Self::Obj => "model/obj",
            Self::ThreeMf => "model/3mf",
            Self::Precomputed => "application/zip",
            Self::Usdz => "model/vnd.usdz+zip",
        }
    }

    /// Whether a file can hold values of fields.
    pub const fn holds_values(self) -> bool {
        matches!(self, Self::Glb | Self::Ply | Self::Vtp | Self::Usdz)
    }

    /// Whether a file can hold the names of surfaces.
    pub const fn holds_names(self) -> bool {
        matches!(
            self,
            Self::Glb | Self::Obj | Self::ThreeMf | Self::Precomputed | Self::Usdz
        )
    }

    /// Whether a file can hold a colour for each surface.
    pub const fn holds_color(self) -> bool {
        matches!(self, Self::Glb | Self::Obj | Self::ThreeMf | Self::Usdz)
    }

    /// Whether a file can hold a colour for each vertex, from a transfer function.
    pub const fn holds_colors(self) -> bool {
        matches!(
            self,
            Self::Glb | Self::Ply | Self::Vtp | Self::Obj | Self::ThreeMf | Self::Usdz
        )
    }

    /// Whether a file can hold an opacity for each surface.
    pub const fn holds_opacity(self) -> bool {
        matches!(self, Self::Glb | Self::ThreeMf | Self::Usdz)
    }

    /// Whether a file can hold several surfaces.
    pub const fn holds_several(self) -> bool {
        matches!(
            self,
            Self::Glb | Self::Obj | Self::ThreeMf | Self::Precomputed | Self::Usdz
        )
    }

    /// Whether world positions are rounded to 32 bits.
    pub const fn rounds(self) -> bool {
        matches!(self, Self::Stl | Self::Gifti | Self::Precomputed)
    }

    /// Returns the unit that the format prescribes for positions; `None` if a file can have any unit.
    pub const fn unit(self) -> Option<LengthUnit> {
        match self {
            Self::Stl | Self::ThreeMf | Self::Gifti => Some(LengthUnit::Millimetre),
            Self::Precomputed => Some(LengthUnit::Nanometre),
            Self::Glb | Self::Ply | Self::Vtp | Self::Obj | Self::Usdz => None,
        }
    }
}

/// Why a surface could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The file name does not imply a format.
    #[error(
        "{0:?} does not say the format: expected a name that ends in .glb, .ply, .stl, .vtp, .obj, .3mf, .surf.gii, .precomputed.zip or .usdz"
    )]
    UnknownExtension(String),
    /// A count exceeds the limit of the format.
    #[error("{what}: {found}, {format} allows {limit}")]
    TooLarge {
        /// Name and unit of the count.
        what: &'static str,
        /// The count.
        found: u64,
        /// Maximum of the count.
        limit: u64,
        /// The format with this limit.
        format: &'static str,
    },
    /// World coordinates exceed the range of the format's numbers.
    #[error("a vertex lies at {0:?} world units, beyond what the numbers of the format hold")]
    OutOfRange([f64; 3]),
    /// The regions of the surface are inconsistent.
    #[error(transparent)]
    Join(JoinError),
    /// The caller has cancelled.
    #[error("cancelled")]
    Cancelled,
    /// Writing failed.
    #[error("the surface could not be written")]
    Io(#[from] io::Error),
}

impl From<JoinError> for ExportError {
    fn from(error: JoinError) -> Self {
        match error {
            JoinError::Cancelled => Self::Cancelled,
            JoinError::TooManyVertices(found) => Self::TooLarge {
                what: "vertices",
                found,
                limit: u64::from(u32::MAX),
                format: "a 32-bit index",
            },
            JoinError::BadRegion { .. } => Self::Join(error),
        }
    }
}

/// Content of a file that is not encoded yet.
#[derive(Clone, Debug)]
pub struct Content {
    /// The surfaces. Exactly one, unless the format can hold several.
    pub meshes: Vec<Mesh>,
    /// File format.
    pub format: Format,
    /// Compression of the file.
    pub compress: Compress,
    /// The `asset.extras` of a GLB. Other formats ignore it.
    pub extras: serde_json::Value,
}

impl Content {
    /// Writes the file. On a thread of a rayon pool, this pool encodes the file in parallel.
    ///
    /// # Errors
    /// The format cannot hold the content, or the errors of `out`.
    pub fn write(&self, out: &mut dyn Write) -> Result<(), ExportError> {
        let meshes = &self.meshes[..];
        match self.format {
            Format::Glb if self.compress == Compress::Meshopt => glb::packed::write(meshes, &self.extras, out),
            Format::Glb => glb::write(meshes, &self.extras, out),
            Format::Ply => ply::write(self.only()?, out),
            Format::Stl => stl::write(self.only()?, out),
            Format::Vtp => vtp::write(self.only()?, self.compress == Compress::Zlib, out),
            Format::Obj => obj::write(meshes, out),
            Format::ThreeMf => three_mf::write(meshes, self.compress == Compress::Zlib, out),
            Format::Gifti => gifti::write(self.only()?, out),
            Format::Precomputed => precomputed::write(meshes, out),
            Format::Usdz => usdz::write(meshes, out),
        }
    }

    /// Returns the only mesh.
    fn only(&self) -> Result<&Mesh, ExportError> {
        match &self.meshes[..] {
            [mesh] => Ok(mesh),
            meshes => Err(ExportError::TooLarge {
                what: "surfaces",
                found: meshes.len() as u64,
                limit: 1,
                format: self.format.title(),
            }),
        }
    }

    /// Returns length and hash of the bytes that [`Content::write`] produces. If this succeeds, [`Content::write`] fails only if `out`
    /// fails.
    ///
    /// # Errors
    /// The format cannot hold the content. [`ExportError::Io`] if `is_cancelled` returns true.
    pub fn digest(&self, is_cancelled: &dyn Fn() -> bool) -> Result<FileDigest, ExportError> {
        let digester = Digester {
            bytes: 0,
            hasher: Xxh3::new(),
            is_cancelled,
        };
        let mut out = BufWriter::with_capacity(DIGEST_BUFFER_BYTES, digester);
        self.write(&mut out)?;
        let Digester { bytes, hasher, .. } = out.into_inner().map_err(io::IntoInnerError::into_error)?;
        let hash = hasher.digest128();
        Ok(FileDigest { bytes, hash })
    }
}

/// Maximum bytes of a file in a ZIP without the headers of ZIP64.
const MAX_BYTES_WITHOUT_ZIP64: u64 = u32::MAX as u64;

/// Length and hash of a file, known before the file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileDigest {
    /// Length in bytes.
    pub bytes: u64,
    /// 128-bit XXH3 of all bytes.
    pub hash: u128,
}

/// Bytes that are hashed at once.
const DIGEST_BUFFER_BYTES: usize = 1 << 16;

/// Writer that counts, hashes and discards its bytes.
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

/// Converts a count to 32 bits. Returns [`ExportError::TooLarge`] if it does not fit.
fn fits_u32(what: &'static str, found: u64, format: &'static str) -> Result<u32, ExportError> {
    u32::try_from(found).map_err(|_| ExportError::TooLarge {
        what,
        found,
        limit: u64::from(u32::MAX),
        format,
    })
}
