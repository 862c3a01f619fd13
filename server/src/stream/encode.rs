//! From the device's regions to chunk bytes: quantise, hash, order, compress. Pure functions on the CPU pool.

use std::cell::RefCell;

use axum::body::Bytes;
use isopeel_kernels::{REGION_CELLS, Region, Vertex};
use meshopt::ffi;
use xxhash_rust::xxh3::Xxh3;

use super::chunk::{ChunkHeader, HEADER_BYTES, LATTICE, VERTEX_BYTES, WireVertex};
use super::order::Walk;

/// A region's mesh, quantised for the wire. [`WireRegion::encode`] puts it into order: most regions of an edit stand as they
/// are and are only hashed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WireRegion {
    /// Region, in units of 32 cells.
    pub coords: [u32; 3],
    /// Vertices, as the device left them.
    pub vertices: Vec<WireVertex>,
    /// Three per triangle, ordered by level, finest first.
    pub indices: Vec<u32>,
    /// Triangles of each level, 0 first.
    pub level_triangles: [u32; 6],
    /// Distance from the surface it stands for, root mean square and maximum, world units; `None`: not stated.
    pub error: Option<[f32; 2]>,
}

/// Why a region or a chunk could not be made; a fault of this program, not of its input.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("region {coords:?}: {why}")]
pub struct EncodeError {
    /// Region, in units of 32 cells.
    pub coords: [u32; 3],
    /// What was found and what was expected.
    pub why: String,
}

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
        let normal = vertex.normal.map(|n| {
            let n = i32::from(n) * 127;
            ((n + n.signum() * 16383) / 32767).clamp(-127, 127) as i8
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
    /// An index past the vertices, or levels that do not add up.
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
        if let Some(index) = region.indices.iter().find(|&&i| i as usize >= vertices) {
            return Err(fault(format!("index {index} of {vertices} vertices")));
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
    ///
    /// # Errors
    /// The codec refuses the mesh.
    pub fn encode(&self, generation: u32, level: u8) -> Result<Bytes, EncodeError> {
        let [error_rms, error_max] = self.error.unwrap_or([f32::NAN; 2]);
        SCRATCH.with_borrow_mut(|scratch| {
            scratch.arrange(self);
            scratch.compress().map_err(|codec| EncodeError {
                coords: self.coords,
                why: format!("the {codec} codec refuses {} indices", self.indices.len()),
            })?;
            let (min, max) = bounds(self.coords, &scratch.vertices);
            let header = ChunkHeader {
                generation,
                level,
                region: self.coords,
                min,
                max,
                vertex_count: scratch.vertices.len() as u32,
                index_count: scratch.indices.len() as u32,
                vertex_bytes: scratch.vertex_payload.len() as u32,
                index_bytes: scratch.index_payload.len() as u32,
                level_triangles: self.level_triangles,
                error_rms,
                error_max,
            };
            let payloads = scratch.vertex_payload.len() + scratch.index_payload.len();
            let mut frame = Vec::with_capacity(HEADER_BYTES + payloads);
            frame.extend_from_slice(&header.to_bytes());
            frame.extend_from_slice(&scratch.vertex_payload);
            frame.extend_from_slice(&scratch.index_payload);
            Ok(frame.into())
        })
    }
}

thread_local! {
    /// One set of buffers for each thread of the pool: once they have grown, a chunk costs one allocation, its own bytes.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Buffers of [`WireRegion::encode`]: what one region needs, some megabytes at the very most.
#[derive(Default)]
struct Scratch {
    walk: Walk,
    /// Indices in their new order.
    indices: Vec<u32>,
    /// Vertices in the order of their first use.
    vertices: Vec<WireVertex>,
    /// New place of each old vertex.
    places: Vec<u32>,
    vertex_payload: Vec<u8>,
    index_payload: Vec<u8>,
}

impl Scratch {
    /// Fills `indices` and `vertices`. [`WireRegion::new`] saw to it that all indices are inside.
    fn arrange(&mut self, region: &WireRegion) {
        const UNUSED: u32 = u32::MAX;
        self.indices.clear();
        self.vertices.clear();
        self.places.clear();
        self.places.resize(region.vertices.len(), UNUSED);
        self.walk.order(
            &region.indices,
            &region.level_triangles,
            region.vertices.len(),
            &mut self.indices,
        );
        for index in &mut self.indices {
            let place = &mut self.places[*index as usize];
            if *place == UNUSED {
                *place = self.vertices.len() as u32;
                self.vertices.push(region.vertices[*index as usize]);
            }
            *index = *place;
        }
    }

    /// Fills the payloads; the codec's name where it fails.
    fn compress(&mut self) -> Result<(), &'static str> {
        self.vertex_payload.clear();
        self.index_payload.clear();
        if self.vertices.is_empty() {
            return Ok(());
        }
        let (vertices, indices) = (self.vertices.as_slice(), self.indices.as_slice());
        // SAFETY: a pure function of two numbers.
        let bound = unsafe { ffi::meshopt_encodeVertexBufferBound(vertices.len(), VERTEX_BYTES) };
        self.vertex_payload.resize(bound, 0);
        // SAFETY: source and destination are slices with the lengths passed, and a vertex is `VERTEX_BYTES` plain bytes, a
        // multiple of 4. The version is named, because its default is a process-wide setting.
        let written = unsafe {
            ffi::meshopt_encodeVertexBufferLevel(
                self.vertex_payload.as_mut_ptr(),
                self.vertex_payload.len(),
                vertices.as_ptr().cast(),
                vertices.len(),
                VERTEX_BYTES,
                VERTEX_EFFORT,
                VERTEX_VERSION,
            )
        };
        self.vertex_payload.truncate(written);
        // SAFETY: a pure function of two numbers.
        let bound = unsafe { ffi::meshopt_encodeIndexBufferBound(indices.len(), vertices.len()) };
        self.index_payload.resize(bound, 0);
        // SAFETY: source and destination are slices with the lengths passed; the number of indices is a multiple of 3, as the
        // levels' triangles add up to it.
        let written = unsafe {
            ffi::meshopt_encodeIndexBuffer(
                self.index_payload.as_mut_ptr(),
                self.index_payload.len(),
                indices.as_ptr(),
                indices.len(),
            )
        };
        self.index_payload.truncate(written);
        match (self.vertex_payload.is_empty(), self.index_payload.is_empty()) {
            (true, _) => Err("vertex"),
            (_, true) => Err("index"),
            _ => Ok(()),
        }
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

/// Effort of the vertex codec, 0 to 3: the least one that tells 16-bit deltas from bytes, which positions need.
const VERTEX_EFFORT: i32 = 2;
/// Version of the vertex codec.
const VERTEX_VERSION: i32 = 1;

#[cfg(test)]
mod tests;
