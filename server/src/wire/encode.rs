//! From the device's regions to chunk bytes: quantise, hash, order, compress. Pure functions on the CPU pool.

use std::cell::RefCell;

use axum::body::Bytes;
use isopeel_kernels::{REGION_CELLS, Region, SharedSlice, Surface, Vertex};
use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3;

use super::chunk::{ChunkHeader, HEADER_BYTES, LATTICE, MAX_INDICES, WireVertex};
use super::index_codec::IndexWriter;
use super::order::Walk;
use super::vertex_codec::VertexWriter;
use crate::error::BoxError;

/// A region's mesh, quantised for the wire. [`WireRegion::encode`] puts it into order: most regions of an edit stand as they
/// are and are only hashed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WireRegion {
    /// Region, in units of 32 cells.
    pub coords: [u32; 3],
    /// Vertices, as the device left them.
    pub vertices: Vec<WireVertex>,
    /// Three per triangle, ordered by level, finest first.
    pub indices: SharedSlice<u32>,
    /// Triangles of each level, 0 first.
    pub level_triangles: [u32; 6],
    /// Distance from the surface it stands for, root mean square and maximum, world units; `None`: not stated.
    pub error: Option<[f32; 2]>,
}

/// Why a region cannot be quantised; a fault of this program, not of its input.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("region {coords:?}: {why}")]
pub struct EncodeError {
    /// Region, in units of 32 cells.
    pub coords: [u32; 3],
    /// What was found and what was expected.
    pub why: String,
}

/// Most regions that a thread of the pool takes in one go, some tenths of a millisecond. Left to itself, rayon gives each of 16 threads
/// one or two hundreds of them, and all wait for the last.
pub const AT_ONCE: usize = 8;

/// Kernel lattice units in one unit of the wire's lattice, a power of two.
const COARSER: i32 = Vertex::LATTICE / LATTICE as i32;
const _: () = assert!(COARSER.count_ones() == 1);

impl WireVertex {
    /// Rounds to the wire's lattice. A region begins at a multiple of its unit, so vertices that are equal in two regions
    /// stay equal. Beyond the 127 cells that 16 bits hold a position is clamped; the kernels promise 64.
    fn quantise(vertex: &Vertex) -> Self {
        // Half up, also below zero: rounding half away from it would part equal positions of two regions.
        let position = vertex.position.map(|p| {
            let unit = (p + COARSER / 2) >> COARSER.trailing_zeros();
            unit.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
        });
        // To the nearest of n / 32767: what a division by 32768 leaves away is its own result, 32768 times less.
        let normal = vertex.normal.map(|n| {
            let n = i32::from(n) * 127;
            ((n + (n >> 15) + (1 << 14)) >> 15) as i8
        });
        Self {
            position,
            normal,
            smoothness: leading_byte(vertex.smoothness),
            feature: leading_byte(vertex.feature),
        }
    }
}

/// To the next multiple of 256, with 65535 for the last one: a byte is finer than the transfer function's colours differ, and
/// the codec stores a byte that never changes for nothing. Both ends stay exact.
fn leading_byte(value: u16) -> u16 {
    match value.saturating_add(128) & 0xff00 {
        0xff00 if value >= 0xff80 => u16::MAX,
        rounded => rounded,
    }
}

impl WireRegion {
    /// Quantises a region.
    ///
    /// # Errors
    /// An index past the vertices, more indices or vertices than a chunk may have, or levels that do not add up.
    pub fn new(region: &Region) -> Result<Self, EncodeError> {
        let fault = |why: String| EncodeError {
            coords: region.coords,
            why,
        };
        let triangles: u64 = region.level_triangles.iter().map(|&n| u64::from(n)).sum();
        if triangles * 3 != region.indices.len() as u64 {
            return Err(fault(format!(
                "{} indices, expected three for each of {triangles} triangles",
                region.indices.len()
            )));
        }
        let vertices = region.vertices.len();
        let most = region.indices.len().max(vertices);
        if most > MAX_INDICES as usize {
            return Err(fault(format!(
                "{most} indices or vertices, expected at most {MAX_INDICES}"
            )));
        }
        // All of them side by side, where a search that may end early takes one by one: above the last one, or 2³¹, the highest bit
        // stands in the difference or in the index itself.
        let last = (vertices as u32).wrapping_sub(1);
        let outside = |found, &index: &u32| found | index | last.wrapping_sub(index);
        if region.indices.iter().fold(0, outside) >> 31 == 1 {
            let greatest = region.indices.iter().max().copied().unwrap_or_default();
            return Err(fault(format!("index {greatest} of {vertices} vertices")));
        }
        Ok(Self {
            coords: region.coords,
            vertices: region.vertices.iter().map(WireVertex::quantise).collect(),
            indices: region.indices.clone(),
            level_triangles: region.level_triangles,
            error: region.error.map(|error| [error.rms, error.max]),
        })
    }

    /// Names this mesh: of two equal meshes one need not be sent. 64 bits: by chance two different meshes of one region
    /// share a name once in 10¹⁹ times.
    pub fn content_hash(&self) -> u64 {
        let mut hash = Xxh3::new();
        hash.update(&(self.vertices.len() as u64).to_le_bytes());
        hash.update(bytemuck::cast_slice(&self.level_triangles));
        let [rms, max] = self.error.unwrap_or([f32::NAN; 2]);
        hash.update(bytemuck::cast_slice(&[rms, max]));
        hash.update(bytemuck::cast_slice(&self.vertices));
        hash.update(bytemuck::cast_slice(&self.indices));
        hash.digest()
    }

    /// The chunk's bytes. Without vertices it removes its region. Triangles of each level travel in an order of their own
    /// and vertices in the order of their first use, which the codecs turn into almost nothing.
    pub fn encode(&self, generation: u32, level: u8) -> Bytes {
        let [error_rms, error_max] = self.error.unwrap_or([f32::NAN; 2]);
        SCRATCH.with_borrow_mut(|scratch| {
            scratch.write(self);
            let vertex_payload = scratch.vertex_payload.payload();
            let index_payload = scratch.indices.payload();
            let (min, max) = bounds(self.coords, &scratch.vertices);
            let header = ChunkHeader {
                generation,
                level,
                region: self.coords,
                min,
                max,
                vertex_count: scratch.vertices.len() as u32,
                index_count: self.indices.len() as u32,
                vertex_bytes: vertex_payload.len() as u32,
                index_bytes: index_payload.iter().map(|part| part.len() as u32).sum(),
                level_triangles: self.level_triangles,
                error_rms,
                error_max,
            };
            let payloads = header.vertex_bytes + header.index_bytes;
            let mut frame = Vec::with_capacity(HEADER_BYTES + payloads as usize);
            frame.extend_from_slice(&header.to_bytes());
            frame.extend_from_slice(vertex_payload);
            index_payload.iter().for_each(|part| frame.extend_from_slice(part));
            frame.into()
        })
    }
}

/// Bytes of all chunks of a surface. On rayon's pool.
///
/// # Errors
/// [`EncodeError`].
pub fn encoded_bytes(surface: &Surface) -> Result<u64, BoxError> {
    let bytes = |region: &Region| Ok(WireRegion::new(region)?.encode(0, 0).len() as u64);
    let regions = surface.regions.par_iter().with_max_len(AT_ONCE);
    Ok(regions.map(bytes).sum::<Result<u64, EncodeError>>()?)
}

thread_local! {
    /// One set of buffers for each thread of the pool: once they have grown, a chunk costs one allocation, its own bytes.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Buffers of [`WireRegion::encode`]: what one region needs, some megabytes at the very most.
#[derive(Default)]
struct Scratch {
    walk: Walk,
    indices: IndexWriter,
    /// In the order of their first use.
    vertices: Vec<WireVertex>,
    vertex_payload: VertexWriter,
}

impl Scratch {
    /// Writes both payloads. [`WireRegion::new`] saw to it that all indices are inside.
    fn write(&mut self, region: &WireRegion) {
        let vertices = region.vertices.len();
        self.indices.begin(vertices, region.indices.len() / 3);
        self.walk
            .write(&region.indices, &region.level_triangles, vertices, &mut self.indices);
        self.vertices.clear();
        let order = self.indices.order().iter();
        self.vertices.extend(order.map(|&old| region.vertices[old as usize]));
        self.vertex_payload.write(&self.vertices);
    }
}

/// Least and greatest position in index space.
fn bounds(coords: [u32; 3], vertices: &[WireVertex]) -> ([f32; 3], [f32; 3]) {
    let Some(first) = vertices.first() else {
        return ([0.0; 3], [0.0; 3]);
    };
    let (mut min, mut max) = (first.position, first.position);
    for vertex in vertices {
        for axis in 0..3 {
            min[axis] = min[axis].min(vertex.position[axis]);
            max[axis] = max[axis].max(vertex.position[axis]);
        }
    }
    // Through f64: past 2¹⁶ cells a sum in f32 loses the lattice.
    let index = |position: [i16; 3]| {
        [0, 1, 2].map(|axis| {
            let corner = f64::from(coords[axis]) * f64::from(REGION_CELLS);
            (corner + f64::from(position[axis]) / f64::from(LATTICE)) as f32
        })
    };
    (index(min), index(max))
}

#[cfg(test)]
mod tests;
