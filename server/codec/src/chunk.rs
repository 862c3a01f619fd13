//! Chunks, the binary frames of the stream: header, checks and decoder. A chunk is the mesh of a region, or the errors of its vertices. The
//! encoder is in `encode`. Normative: `PROTOCOL.md`, section 4.

use bytes::Bytes;
use isopeel_kernels::{REGION_CELLS, RegionKey};
use serde::Serialize;

use super::values::Values;

/// First bytes of a chunk.
pub const MAGIC: [u8; 4] = *b"ISOP";
/// Version of the layout.
pub const VERSION: u16 = 3;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 96;
/// Maximum number of surfaces that the layout can distinguish.
pub const MAX_SURFACES: u8 = 4;
/// Lattice units per cell. Rounding moves a vertex by 0.005 cells across the surface (rms). That is a sixth of the distance between the
/// smoothest mesh and the isosurface.
pub const LATTICE: u16 = 64;
/// Maximum size of a region, [`RegionKey::size`].
pub const MAX_REGION_SIZE: u8 = 2;
/// Bytes of a vertex before compression.
pub const VERTEX_BYTES: usize = 12;
/// Maximum indices of a region of 32³ cells: two triangles for each grid edge in it and on its faces. Marching cubes has fewer, 5 a cell.
/// Larger regions have at most 2000 triangles.
pub const MAX_INDICES: u32 = 3 * 2 * 3 * REGION_CELLS * (REGION_CELLS + 1) * (REGION_CELLS + 1);

// Vertices are sent as they are in memory, and the wire is little-endian.
const _: () = assert!(cfg!(target_endian = "little"), "isopeel needs a little-endian machine");

/// A vertex on the wire.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct WireVertex {
    /// Position from the region's low corner in units of 1/[`LATTICE`] cell.
    pub position: [i16; 3],
    /// Unit normal towards lower values, octahedral, over 127.
    pub normal: [i8; 2],
    /// Smoothness feature `s`, over 65535.
    pub smoothness: u16,
    /// Normalised user feature `f̂`, over 65535.
    pub feature: u16,
}

const _: () = assert!(size_of::<WireVertex>() == VERTEX_BYTES);

/// What a chunk's triangles are; the wire has it as a number in chunks and as text in messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum ChunkKind {
    /// A region of a prefix of the cut.
    Cut = 0,
    /// The distance of each vertex of a region to the isosurface, of a chunk that was sent before.
    Error = 1,
}

impl ChunkKind {
    /// Every kind that this version makes and reads.
    pub const ALL: [Self; 2] = [Self::Cut, Self::Error];

    fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|&kind| kind as u8 == number)
    }
}

/// Bit of the flags that says that values of a field follow the payloads.
const HAS_VALUES: u8 = 2;

/// Name of the values in the list of codings of a client that reads them.
const VALUES: &str = "values";

/// Whether a client that has sent these names of codings reads chunks with values.
pub fn reads_values(names: &[String]) -> bool {
    names.iter().any(|name| name == VALUES)
}

/// How a chunk's mesh is coded: the lowest bit of its flags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coding {
    /// The mesh is coded by meshoptimizer's codecs.
    #[default]
    Meshopt = 0,
    /// The mesh is coded by predictions ([`super::predictive`]); only for clients that request it.
    Predictive = 1,
}

impl Coding {
    /// Name of [`Coding::Predictive`] in messages.
    const PREDICTIVE: &str = "predictive";

    /// Returns the best coding for a client that has sent these names of codings.
    pub fn asked_for(names: &[String]) -> Self {
        match names.iter().any(|name| name == Self::PREDICTIVE) {
            true => Self::Predictive,
            false => Self::Meshopt,
        }
    }

    /// Returns the coding, and whether the chunk has values.
    fn from_flags(flags: u8) -> Result<(Self, bool), ChunkError> {
        [Self::Meshopt, Self::Predictive]
            .into_iter()
            .find(|&coding| coding as u8 == flags & !HAS_VALUES)
            .map(|coding| (coding, flags & HAS_VALUES != 0))
            .ok_or_else(|| {
                ChunkError(format!(
                    "flags {flags}, expected 0 (meshopt) or 1 (predictive), and 2 more with values"
                ))
            })
    }
}

/// The prefix that a chunk belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PrefixId {
    /// Number of the surface, below [`MAX_SURFACES`].
    pub surface: u8,
    /// Generation of the edit.
    pub generation: u32,
    /// Level of the prefix, 0 to 5.
    pub level: u8,
    /// Kind of the prefix's chunks.
    pub kind: ChunkKind,
}

/// Header of a chunk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChunkHeader {
    /// The prefix that the chunk belongs to.
    pub prefix: PrefixId,
    /// How the mesh is coded.
    pub coding: Coding,
    /// Whether values of a field follow the payloads.
    pub has_values: bool,
    /// The region.
    pub region: RegionKey,
    /// Minimum position of the vertices, index space; zeros if there are none.
    pub min: [f32; 3],
    /// Maximum position of the vertices, index space; zeros if there are none.
    pub max: [f32; 3],
    /// Number of vertices.
    pub vertex_count: u32,
    /// Number of indices, three per triangle.
    pub index_count: u32,
    /// Bytes of the vertex payload.
    pub vertex_bytes: u32,
    /// Bytes of the index payload.
    pub index_bytes: u32,
    /// Number of triangles of each level, 0 first.
    pub level_triangles: [u32; 6],
}

/// The bytes of a header that state the prefix to which the chunk belongs.
const PREFIX_BYTES: std::ops::Range<usize> = 8..15;

/// Relabels an encoded chunk as a chunk of this prefix. Returns a chunk that belongs to the prefix already without copying its bytes.
pub fn with_prefix(frame: &Bytes, prefix: PrefixId) -> Bytes {
    let prefix = prefix.to_bytes();
    if frame[PREFIX_BYTES] == prefix {
        return frame.clone();
    }
    let mut copy = frame.to_vec();
    copy[PREFIX_BYTES].copy_from_slice(&prefix);
    copy.into()
}

/// Why a frame is not a chunk: the field, what was found and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("mesh chunk: {0}")]
pub struct ChunkError(String);

impl ChunkError {
    pub(super) fn new(why: String) -> Self {
        Self(why)
    }
}

/// Returns the error that `describe` gives unless `is_valid`.
fn check(is_valid: bool, describe: &dyn Fn() -> String) -> Result<(), ChunkError> {
    if is_valid { Ok(()) } else { Err(ChunkError(describe())) }
}

impl PrefixId {
    /// Returns the id of a prefix of the cut.
    pub const fn cut(surface: u8, generation: u32, level: u8) -> Self {
        Self {
            surface,
            generation,
            level,
            kind: ChunkKind::Cut,
        }
    }

    /// Returns the bytes that a header has from [`PREFIX_BYTES`] on: the generation, and the three bytes that follow it.
    fn to_bytes(self) -> [u8; 7] {
        let [a, b, c, d] = self.generation.to_le_bytes();
        [a, b, c, d, self.level, self.kind as u8, self.surface]
    }

    /// Parses the generation and the three bytes that follow it.
    fn parse(generation: u32, [level, kind, surface]: [u8; 3]) -> Result<Self, ChunkError> {
        check(level <= 5, &|| format!("prefix level {level}, expected 0 to 5"))?;
        let kind = ChunkKind::from_number(kind)
            .ok_or_else(|| ChunkError(format!("kind {kind}, expected 0 (cut) or 1 (error)")))?;
        check(surface < MAX_SURFACES, &|| {
            format!("surface {surface}, expected 0 to {}", MAX_SURFACES - 1)
        })?;
        Ok(Self {
            surface,
            generation,
            level,
            kind,
        })
    }
}

/// Returns the key of a region.
///
/// # Errors
/// The size is too large, or the coordinates are not multiples of 2^`size`.
pub(super) fn region_key(coords: [u32; 3], size: u16) -> Result<RegionKey, String> {
    let Some(allowed) = u8::try_from(size).ok().filter(|&size| size <= MAX_REGION_SIZE) else {
        return Err(format!("region size {size}, expected 0 to {MAX_REGION_SIZE}"));
    };
    let step = 1 << allowed;
    if coords.iter().any(|coordinate| coordinate % step != 0) {
        return Err(format!(
            "region {coords:?} of size {size}, expected multiples of {step}"
        ));
    }
    Ok(RegionKey { coords, size: allowed })
}

impl ChunkHeader {
    /// Returns the header's bytes.
    pub fn to_bytes(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let mut offset = 0;
        let mut append = |field: &[u8]| {
            bytes[offset..offset + field.len()].copy_from_slice(field);
            offset += field.len();
        };
        append(&MAGIC);
        append(&VERSION.to_le_bytes());
        append(&(HEADER_BYTES as u16).to_le_bytes());
        append(&self.prefix.to_bytes());
        append(&[self.coding as u8 | if self.has_values { HAS_VALUES } else { 0 }]);
        append(&LATTICE.to_le_bytes());
        append(&u16::from(self.region.size).to_le_bytes());
        self.region.coords.iter().for_each(|v| append(&v.to_le_bytes()));
        self.min.iter().for_each(|v| append(&v.to_le_bytes()));
        self.max.iter().for_each(|v| append(&v.to_le_bytes()));
        append(&self.vertex_count.to_le_bytes());
        append(&self.index_count.to_le_bytes());
        append(&self.vertex_bytes.to_le_bytes());
        append(&self.index_bytes.to_le_bytes());
        self.level_triangles.iter().for_each(|v| append(&v.to_le_bytes()));
        bytes
    }

    /// Reads and checks the header of a whole frame. Allocates nothing, because counts in a frame are not to be trusted.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn parse(frame: &[u8]) -> Result<Self, ChunkError> {
        check(frame.len() >= HEADER_BYTES, &|| {
            format!("{} bytes, expected a header of {HEADER_BYTES} bytes", frame.len())
        })?;
        let u16_at = |offset: usize| u16::from_le_bytes([frame[offset], frame[offset + 1]]);
        let u32_at = |offset: usize| {
            u32::from_le_bytes([frame[offset], frame[offset + 1], frame[offset + 2], frame[offset + 3]])
        };
        let f32_at = |offset: usize| f32::from_bits(u32_at(offset));
        check(frame[..4] == MAGIC, &|| {
            format!("magic {:?}, expected {MAGIC:?}", &frame[..4])
        })?;
        let expect_u16 = |offset: usize, name: &str, expected: u16| {
            let found = u16_at(offset);
            check(found == expected, &|| format!("{name} {found}, expected {expected}"))
        };
        expect_u16(4, "version", VERSION)?;
        expect_u16(6, "header length", HEADER_BYTES as u16)?;
        expect_u16(16, "lattice units per cell", LATTICE)?;
        let prefix = PrefixId::parse(u32_at(8), [frame[12], frame[13], frame[14]])?;
        let (coding, has_values) = Coding::from_flags(frame[15])?;
        let header = Self {
            prefix,
            coding,
            has_values,
            region: region_key([20, 24, 28].map(u32_at), u16_at(18)).map_err(ChunkError)?,
            min: [32, 36, 40].map(f32_at),
            max: [44, 48, 52].map(f32_at),
            vertex_count: u32_at(56),
            index_count: u32_at(60),
            vertex_bytes: u32_at(64),
            index_bytes: u32_at(68),
            level_triangles: [72, 76, 80, 84, 88, 92].map(u32_at),
        };
        header.check(frame.len())?;
        Ok(header)
    }

    /// Checks counts and lengths against each other and the frame.
    fn check(&self, frame_bytes: usize) -> Result<(), ChunkError> {
        let Self {
            vertex_count,
            index_count,
            vertex_bytes,
            index_bytes,
            ..
        } = *self;
        check(index_count % 3 == 0, &|| {
            format!("{index_count} indices, expected a multiple of 3")
        })?;
        check(index_count <= MAX_INDICES && vertex_count <= index_count, &|| {
            format!(
                "{vertex_count} vertices and {index_count} indices, expected at most {MAX_INDICES} indices and no more vertices"
            )
        })?;
        check((vertex_count == 0) == (index_count == 0), &|| {
            format!("{vertex_count} vertices with {index_count} indices")
        })?;
        let triangles: u64 = self.level_triangles.iter().map(|&n| u64::from(n)).sum();
        check(triangles == u64::from(index_count / 3), &|| {
            format!("levels add up to {triangles} triangles, expected {}", index_count / 3)
        })?;
        let length = HEADER_BYTES as u64 + u64::from(vertex_bytes) + u64::from(index_bytes);
        let has_rest = frame_bytes as u64 > length;
        check(
            length <= frame_bytes as u64 && has_rest == self.has_values,
            &|| match self.has_values {
                true => format!("header and payloads are {length} bytes, the frame has {frame_bytes}, expected more"),
                false => format!("header and payloads are {length} bytes, the frame has {frame_bytes}"),
            },
        )?;
        check(!self.has_values || vertex_count > 0, &|| {
            "values of a chunk without vertices, expected none".into()
        })?;
        if self.prefix.kind == ChunkKind::Error {
            check(self.coding == Coding::Meshopt && !self.has_values, &|| {
                "flags of kind 1 (error), expected 0".into()
            })?;
            return check(
                index_bytes == 0 && u64::from(vertex_bytes) == 4 * u64::from(vertex_count),
                &|| {
                    format!(
                        "errors of {vertex_count} vertices in payloads of {vertex_bytes} and {index_bytes} bytes, expected 4 a vertex"
                    )
                },
            );
        }
        let is_empty = vertex_count == 0;
        let has_indices = !is_empty && self.coding == Coding::Meshopt;
        check(
            is_empty == (vertex_bytes == 0) && has_indices == (index_bytes > 0),
            &|| format!("{vertex_count} vertices in payloads of {vertex_bytes} and {index_bytes} bytes"),
        )?;
        Ok(())
    }
}

/// A decoded chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedChunk {
    /// The header.
    pub header: ChunkHeader,
    /// Vertices, in the order of their indices.
    pub vertices: Vec<WireVertex>,
    /// Three indices per triangle, ordered by level, finest first. Each index is below the number of vertices.
    pub indices: Vec<u32>,
    /// The value of a field at each vertex, NaN if it is missing; empty if the chunk has none.
    pub values: Vec<f32>,
}

/// Returns the chunk without its values, for a client that does not read them. Copies the bytes only if there are values.
pub fn without_values(frame: &Bytes) -> Bytes {
    const FLAGS: usize = 15;
    let Some(flags) = frame.get(FLAGS).filter(|flags| **flags & HAS_VALUES != 0) else {
        return frame.clone();
    };
    let Ok(header) = ChunkHeader::parse(frame) else {
        return frame.clone();
    };
    let mut copy = frame[..header.payloads_end()].to_vec();
    copy[FLAGS] = flags & !HAS_VALUES;
    copy.into()
}

impl ChunkHeader {
    /// Returns the end of the payloads in the frame, at which the values begin.
    fn payloads_end(&self) -> usize {
        HEADER_BYTES + self.vertex_bytes as usize + self.index_bytes as usize
    }

    /// Reads the values of a frame with this header, if it has any.
    pub(super) fn values(&self, frame: &[u8]) -> Result<Option<Values>, ChunkError> {
        let values = || Values::parse(&frame[self.payloads_end()..], self.vertex_count as usize);
        self.has_values.then(values).transpose().map_err(ChunkError)
    }

    /// Reads the value of each vertex of a frame with this header; empty if it has none.
    pub(super) fn vertex_values(&self, frame: &[u8]) -> Result<Vec<f32>, ChunkError> {
        let values = self.values(frame)?;
        Ok(values.map(|values| values.to_vec()).unwrap_or_default())
    }
}

/// Decodes a chunk of errors: the distances of a region's vertices to the isosurface. Safe on any bytes.
///
/// # Errors
/// The fault of the frame.
pub fn decode_errors(frame: &[u8]) -> Result<(ChunkHeader, Vec<f32>), ChunkError> {
    let header = ChunkHeader::parse(frame)?;
    check(header.prefix.kind == ChunkKind::Error, &|| {
        "kind 0 (cut), expected 1 (error)".into()
    })?;
    let distances = bytemuck::pod_collect_to_vec(&frame[HEADER_BYTES..]);
    Ok((header, distances))
}

/// Decodes a chunk of a mesh in the coding [`Coding::Meshopt`]. Safe on any bytes.
///
/// # Errors
/// The fault of the frame.
pub(super) fn decode_meshopt(frame: &[u8]) -> Result<DecodedChunk, ChunkError> {
    let header = ChunkHeader::parse(frame)?;
    check(header.prefix.kind == ChunkKind::Cut, &|| {
        "kind 1 (error), expected 0 (cut)".into()
    })?;
    check(header.coding == Coding::Meshopt, &|| {
        "flags with 1 (predictive), expected 0 (meshopt)".into()
    })?;
    if header.vertex_count == 0 {
        return Ok(DecodedChunk {
            header,
            vertices: Vec::new(),
            indices: Vec::new(),
            values: Vec::new(),
        });
    }
    let payloads = &frame[HEADER_BYTES..header.payloads_end()];
    let (vertex_payload, index_payload) = payloads.split_at(header.vertex_bytes as usize);
    let vertices: Vec<WireVertex> = meshopt::decode_vertex_buffer(vertex_payload, header.vertex_count as usize)
        .map_err(|error| ChunkError(format!("vertex payload: {error}")))?;
    let indices: Vec<u32> = meshopt::decode_index_buffer(index_payload, header.index_count as usize)
        .map_err(|error| ChunkError(format!("index payload: {error}")))?;
    if let Some(index) = indices.iter().find(|&&i| i >= header.vertex_count) {
        return Err(ChunkError(format!("index {index} of {} vertices", header.vertex_count)));
    }
    Ok(DecodedChunk {
        values: header.vertex_values(frame)?,
        header,
        vertices,
        indices,
    })
}
