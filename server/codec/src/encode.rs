//! Encodes the device's regions as chunks: hashes, orders, quantises and compresses their meshes. Called on the CPU pool.

use std::cell::RefCell;

use bytes::Bytes;
use isopeel_kernels::{REGION_CELLS, Region, RegionKey, Surface, Vertex};
use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3;

use super::chunk::{
    ChunkHeader, Coding, HEADER_BYTES, LATTICE, MAX_INDICES, PrefixId, VERTEX_BYTES, WireVertex, region_key,
};
use super::index_codec::IndexWriter;
use super::order::Traversal;
use super::predictive;
use super::values::Values;
use super::vertex_codec::VertexWriter;

/// Why a region cannot be encoded. Such an error is a fault of this program, not of its input.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("region {:?} of size {}: {why}", region.coords, region.size)]
pub struct EncodeError {
    /// The region.
    pub region: RegionKey,
    /// The invalid value, and the expected one.
    pub why: String,
}

/// Maximum regions of a rayon task. A task of this size takes a few tenths of a millisecond. By default rayon gives each thread several
/// times as many regions, and then all threads wait for the slowest one.
pub const MAX_TASK_REGIONS: usize = 2;

/// Units of the kernels' lattice in one unit of the wire's lattice, a power of two.
const LATTICE_RATIO: i32 = Vertex::LATTICE / LATTICE as i32;
const _: () = assert!(LATTICE_RATIO.count_ones() == 1);

/// Random bits that are combined with the hashed values, so that zeros in a vertex do not make the product 0.
const HASH_KEYS: [u64; 2] = [0xa076_1d64_78bd_642f, 0xe703_7ed1_a0b4_28db];

/// Number of triangles that are hashed at a time.
const HASHED_TRIANGLES: usize = 32;

impl WireVertex {
    /// Rounds a vertex to the wire's lattice. A region begins at a multiple of the lattice's unit, so vertices that are equal in two
    /// regions stay equal. Positions are clamped to 16 bits, which hold 511 cells; [`encode`] refuses a region in which one exceeds them.
    pub fn quantise(vertex: &Vertex) -> Self {
        let clamp = |unit: i32| unit.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
        let position = vertex.position.map(|coordinate| clamp(rounded(coordinate)));
        // n / 32767, rounded, by the first two terms of its series: n / 2¹⁵ + n / 2³⁰.
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

    /// Returns the hash of all bytes of the vertex that are sent.
    fn hash(self) -> u64 {
        let [a, b, c]: [u32; VERTEX_BYTES / 4] = bytemuck::cast(self);
        let first = u64::from(a) | u64::from(b) << 32;
        folded_product(first ^ HASH_KEYS[0], u64::from(c) ^ HASH_KEYS[1])
    }
}

/// Returns a coordinate in units of the wire's lattice. Rounds half up, also below zero. Rounding half away from zero would round equal
/// positions of two regions differently. A coordinate that overflows becomes one below -2²⁰, which does not fit 16 bits either.
fn rounded(coordinate: i32) -> i32 {
    coordinate.wrapping_add(LATTICE_RATIO / 2) >> LATTICE_RATIO.trailing_zeros()
}

/// Rounds to a multiple of 256. The highest values become 65535, so that both ends of the range are exact. Eight bits are enough, because
/// the colours of a transfer function differ by less. The low bytes are constant then, and the codec needs no bytes for a constant plane.
fn leading_byte(value: u16) -> u16 {
    match value.saturating_add(128) & 0xff00 {
        0xff00 if value >= 0xff80 => u16::MAX,
        rounded => rounded,
    }
}

/// Returns the chunk of a region, with values if the region has them. A chunk without vertices removes its region. For the best compression,
/// triangles are ordered within their level, and vertices by their first use.
///
/// # Errors
/// An index is above the last vertex, there are more indices or vertices than a chunk may have, the levels do not add up, the region has a
/// wrong size or place, or a vertex is farther from the region's low corner than 16 bits can say.
pub fn encode(region: &Region, prefix: PrefixId) -> Result<Bytes, EncodeError> {
    check(region)?;
    SCRATCH.with_borrow_mut(|scratch| {
        scratch.write(region);
        let vertex_payload = scratch.vertex_payload.payload();
        let index_payload = scratch.indices.payload();
        let values = match region.values.is_empty() || scratch.vertices.is_empty() {
            true => Vec::new(),
            false => {
                let order = scratch.indices.order().iter();
                let values = Values::new(order.map(|&old| region.values[old as usize]));
                values.to_bytes().map_err(|why| EncodeError {
                    region: region.key(),
                    why,
                })?
            }
        };
        let (min, max) = bounds(region.key(), &scratch.vertices);
        let header = ChunkHeader {
            prefix,
            coding: Coding::Meshopt,
            has_values: !values.is_empty(),
            region: region.key(),
            min,
            max,
            vertex_count: scratch.vertices.len() as u32,
            index_count: region.indices.len() as u32,
            vertex_bytes: vertex_payload.len() as u32,
            index_bytes: index_payload.iter().map(|part| part.len() as u32).sum(),
            level_triangles: region.level_triangles,
        };
        let payloads = header.vertex_bytes + header.index_bytes;
        let mut frame = Vec::with_capacity(HEADER_BYTES + payloads as usize + values.len());
        frame.extend_from_slice(&header.to_bytes());
        frame.extend_from_slice(vertex_payload);
        index_payload.iter().for_each(|part| frame.extend_from_slice(part));
        frame.extend_from_slice(&values);
        Ok(frame.into())
    })
}

/// Returns the chunk that removes a region.
///
/// # Errors
/// As [`encode`], although an empty region causes only those of its size and place.
pub fn encode_gone(key: RegionKey, prefix: PrefixId) -> Result<Bytes, EncodeError> {
    let region = Region {
        coords: key.coords,
        size: key.size,
        ..Region::default()
    };
    encode(&region, prefix)
}

/// Returns the chunk of the errors of a region's vertices. The errors are in the order of the vertices in the region's chunk of this
/// coding.
///
/// # Errors
/// As [`encode`], or if there are more or fewer errors than vertices.
pub fn encode_errors(
    region: &Region,
    errors: &[f32],
    (prefix, coding): (PrefixId, Coding),
) -> Result<Bytes, EncodeError> {
    check(region)?;
    if errors.len() != region.vertices.len() {
        return Err(EncodeError {
            region: region.key(),
            why: format!("{} errors of {} vertices", errors.len(), region.vertices.len()),
        });
    }
    let predictive_order = match coding {
        Coding::Meshopt => None,
        Coding::Predictive => Some(order_of_predictive(region)?),
    };
    SCRATCH.with_borrow_mut(|scratch| {
        scratch.write(region);
        let (min, max) = bounds(region.key(), &scratch.vertices);
        let vertex_count = scratch.vertices.len() as u32;
        let header = ChunkHeader {
            prefix,
            coding: Coding::Meshopt,
            has_values: false,
            region: region.key(),
            min,
            max,
            vertex_count,
            index_count: region.indices.len() as u32,
            vertex_bytes: 4 * vertex_count,
            index_bytes: 0,
            level_triangles: region.level_triangles,
        };
        let mut frame = Vec::with_capacity(HEADER_BYTES + header.vertex_bytes as usize);
        frame.extend_from_slice(&header.to_bytes());
        let order = scratch.indices.order();
        let mut push = |old: u32| frame.extend_from_slice(&errors[old as usize].to_le_bytes());
        match predictive_order {
            None => order.iter().for_each(|&old| push(old)),
            Some(predictive_order) => predictive_order.iter().for_each(|&sent| push(order[sent as usize])),
        }
        Ok(frame.into())
    })
}

/// Returns, for each vertex of the predictive chunk, its number in the chunk of [`encode`].
fn order_of_predictive(region: &Region) -> Result<Vec<u32>, EncodeError> {
    let chunk = encode(region, PrefixId::cut(0, 0, 0))?;
    predictive::order(&chunk).map_err(|error| EncodeError {
        region: region.key(),
        why: error.to_string(),
    })
}

/// Checks that the levels add up, and that the place, the indices, the numbers and the positions are in range.
fn check(region: &Region) -> Result<(), EncodeError> {
    let fault = |why: String| EncodeError {
        region: region.key(),
        why,
    };
    region_key(region.coords, region.size.into()).map_err(fault)?;
    let triangles: u64 = region.level_triangles.iter().map(|&n| u64::from(n)).sum();
    if triangles * 3 != region.indices.len() as u64 {
        return Err(fault(format!(
            "{} indices, expected three for each of {triangles} triangles",
            region.indices.len()
        )));
    }
    let vertices = region.vertices.len();
    if !region.values.is_empty() && region.values.len() != vertices {
        return Err(fault(format!("{} values of {vertices} vertices", region.values.len())));
    }
    let longer = region.indices.len().max(vertices);
    if longer > MAX_INDICES as usize {
        return Err(fault(format!(
            "{longer} indices or vertices, expected at most {MAX_INDICES}"
        )));
    }
    // The highest bit is set in an index of 2³¹ or more, and in the difference between the last vertex and an index above it. A fold over
    // all indices is vectorised; a search that may end early is not.
    let last = (vertices as u32).wrapping_sub(1);
    let outside = |bits, &index: &u32| bits | index | last.wrapping_sub(index);
    if region.indices.iter().fold(0, outside) >> 31 == 1 {
        let max = region.indices.iter().max().copied().unwrap_or_default();
        return Err(fault(format!("index {max} of {vertices} vertices")));
    }
    check_positions(region).map_err(fault)
}

/// Checks that 16 bits hold the positions of all vertices that are sent.
fn check_positions(region: &Region) -> Result<(), String> {
    // The bits of a coordinate above the lowest 16, counted from the smallest coordinate that 16 bits hold.
    let excess = |coordinate: i32| rounded(coordinate).wrapping_sub(i32::from(i16::MIN)) & !0xffff;
    let excess_of = |vertex: &Vertex| vertex.position.into_iter().fold(0, |bits, x| bits | excess(x));
    // A fold over all vertices is vectorised, too.
    if region.vertices.iter().fold(0, |bits, vertex| bits | excess_of(vertex)) == 0 {
        return Ok(());
    }
    // Vertices without triangles are not sent.
    let is_outside = |index: &&u32| excess_of(&region.vertices[**index as usize]) != 0;
    let Some(&index) = region.indices.iter().find(is_outside) else {
        return Ok(());
    };
    let position = region.vertices[index as usize].position;
    let cells = position.map(|coordinate| f64::from(coordinate) / f64::from(Vertex::LATTICE));
    Err(format!(
        "vertex {index} is {cells:?} cells from the low corner, expected at most 511 along each axis"
    ))
}

/// Hashes of a region's mesh as it is sent. They depend on the sent values of the vertices, not on their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshHash {
    /// Hash of the triangles, independent of their order. A region whose triangles the client holds is not sent again. The probability that
    /// two different meshes of one region collide is 10⁻¹⁹.
    pub unordered: u64,
    /// Hash of the triangles and their corners in order, which identifies the chunk.
    pub ordered: u64,
}

impl MeshHash {
    /// Hashes a region's mesh.
    pub fn of(region: &Region) -> Self {
        VERTEX_HASHES.with_borrow_mut(|hashes| {
            hashes.clear();
            hashes.extend(region.vertices.iter().map(|vertex| WireVertex::quantise(vertex).hash()));
            for (hash, value) in hashes.iter_mut().zip(region.values.iter()) {
                *hash = folded_product(*hash ^ HASH_KEYS[1], u64::from(value.to_bits()) ^ HASH_KEYS[0]);
            }
            // A missing hash is no error here, because an index above the last vertex is refused when the region is encoded.
            let hash_of = |index: u32| hashes.get(index as usize).copied().unwrap_or_default();
            let (mut unordered, mut ordered) = (0_u64, Xxh3::new());
            let mut remaining = region.indices.as_chunks::<3>().0;
            for count in region.level_triangles {
                let (level, coarser) = remaining.split_at_checked(count as usize).unwrap_or((remaining, &[]));
                remaining = coarser;
                let mut sum = u64::from(count);
                for batch in level.chunks(HASHED_TRIANGLES) {
                    let mut corners = [[0; 3]; HASHED_TRIANGLES];
                    for (corner_hashes, triangle) in corners.iter_mut().zip(batch) {
                        *corner_hashes = triangle.map(hash_of);
                        sum = sum.wrapping_add(triangle_hash(*corner_hashes));
                    }
                    ordered.update(bytemuck::cast_slice(&corners[..batch.len()]));
                }
                ordered.update(&count.to_le_bytes());
                unordered = folded_product(unordered ^ sum, HASH_KEYS[0]).wrapping_add(sum);
            }
            let ordered = ordered.digest();
            Self { unordered, ordered }
        })
    }
}

/// Returns the exclusive or of both halves of a product, as wyhash does.
fn folded_product(a: u64, b: u64) -> u64 {
    let product = u128::from(a) * u128::from(b);
    product as u64 ^ (product >> 64) as u64
}

/// Returns the hash of a triangle from the hashes of its corners. The hash does not depend on which corner comes first.
fn triangle_hash([a, b, c]: [u64; 3]) -> u64 {
    let edge = |from: u64, to: u64| folded_product(from ^ HASH_KEYS[0], to.rotate_left(32) ^ HASH_KEYS[1]);
    let sum = edge(a, b).wrapping_add(edge(b, c)).wrapping_add(edge(c, a));
    folded_product(sum ^ HASH_KEYS[1], HASH_KEYS[0])
}

/// Returns the bytes of all chunks of a surface; `None` if it is cancelled. Runs on the caller's rayon pool.
///
/// # Errors
/// [`EncodeError`].
pub fn encoded_bytes(surface: &Surface, is_cancelled: &(dyn Fn() -> bool + Sync)) -> Result<Option<u64>, EncodeError> {
    // Any prefix will do, because the length of a chunk does not depend on it. `Err(None)` means cancelled.
    let bytes = |region: &Region| match is_cancelled() {
        true => Err(None),
        false => Ok(encode(region, PrefixId::cut(0, 0, 0)).map_err(Some)?.len() as u64),
    };
    let regions = surface.regions.par_iter().with_max_len(MAX_TASK_REGIONS);
    match regions.map(bytes).sum::<Result<u64, Option<EncodeError>>>() {
        Ok(bytes) => Ok(Some(bytes)),
        Err(None) => Ok(None),
        Err(Some(error)) => Err(error),
    }
}

thread_local! {
    /// One set of buffers for each thread. Once they have grown, encoding a chunk allocates only the chunk's bytes.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
    /// Hashes of a region's vertices.
    static VERTEX_HASHES: RefCell<Vec<u64>> = RefCell::default();
}

/// Buffers of [`encode`], at most some megabytes.
#[derive(Default)]
struct Scratch {
    traversal: Traversal,
    indices: IndexWriter,
    /// Vertices in the device's order.
    quantised: Vec<WireVertex>,
    /// Vertices in the order of their first use.
    vertices: Vec<WireVertex>,
    vertex_payload: VertexWriter,
}

impl Scratch {
    /// Writes both payloads of a region whose indices were checked.
    fn write(&mut self, region: &Region) {
        let vertices = region.vertices.len();
        self.indices.begin(vertices, region.indices.len() / 3);
        self.traversal
            .write(&region.indices, &region.level_triangles, vertices, &mut self.indices);
        // Quantises all vertices, because that loop is vectorised, and then selects those that are used.
        self.quantised.clear();
        self.quantised.extend(region.vertices.iter().map(WireVertex::quantise));
        self.vertices.clear();
        let order = self.indices.order().iter();
        self.vertices.extend(order.map(|&old| self.quantised[old as usize]));
        self.vertex_payload.write(&self.vertices);
    }
}

/// Returns the minimum and the maximum position in index space.
fn bounds(region: RegionKey, vertices: &[WireVertex]) -> ([f32; 3], [f32; 3]) {
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
    // Computes in f64, because above 2¹⁶ cells a sum in f32 is too coarse for the lattice.
    let index = |position: [i16; 3]| {
        [0, 1, 2].map(|axis| {
            let corner = f64::from(region.coords[axis]) * f64::from(REGION_CELLS);
            (corner + f64::from(position[axis]) / f64::from(LATTICE)) as f32
        })
    };
    (index(min), index(max))
}

#[cfg(test)]
mod tests;
