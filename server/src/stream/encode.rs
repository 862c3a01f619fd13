//! From the device's regions to chunk bytes: quantise, order, hash, compress. Pure functions on the CPU pool.

use axum::body::Bytes;
use isopeel_kernels::{REGION_CELLS, Region, Vertex};
use xxhash_rust::xxh3::Xxh3;

use super::chunk::{ChunkHeader, HEADER_BYTES, LATTICE, WireVertex};

/// A region's mesh, quantised for the wire.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WireRegion {
    /// Region, in units of 32 cells.
    pub coords: [u32; 3],
    /// Vertices, in the order of their first use.
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

/// Kernel lattice units in one unit of the wire's lattice.
const COARSER: i32 = Vertex::LATTICE / LATTICE as i32;

impl WireVertex {
    /// Rounds to the wire's lattice. A region begins at a multiple of its unit, so vertices that are equal in two regions
    /// stay equal. Beyond the 127 cells that 16 bits hold a position is clamped; the kernels promise 64.
    fn quantise(vertex: &Vertex) -> Self {
        // Half up, also below zero: rounding half away from it would part equal positions of two regions.
        let position = vertex.position.map(|p| {
            let unit = (p + COARSER / 2).div_euclid(COARSER);
            unit.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
        });
        let normal = vertex.normal.map(|n| {
            let n = i32::from(n) * 127;
            ((n + n.signum() * 16383) / 32767).clamp(-127, 127) as i8
        });
        Self {
            position,
            normal,
            smoothness: vertex.smoothness,
            feature: vertex.feature,
        }
    }
}

impl WireRegion {
    /// Quantises a region and puts its vertices into the order of their first use, which the index codec turns into
    /// almost nothing. Triangles stay in their order: levels are ranges of it.
    ///
    /// # Errors
    /// An index past the vertices, or levels that do not add up.
    pub fn new(region: &Region) -> Result<Self, EncodeError> {
        const UNUSED: u32 = u32::MAX;
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
        let mut place = vec![UNUSED; region.vertices.len()];
        let mut vertices = Vec::with_capacity(region.vertices.len());
        let mut indices = Vec::with_capacity(region.indices.len());
        for &index in &region.indices {
            let slot = place
                .get_mut(index as usize)
                .ok_or_else(|| fault(format!("index {index} of {} vertices", region.vertices.len())))?;
            if *slot == UNUSED {
                *slot = vertices.len() as u32;
                vertices.push(WireVertex::quantise(&region.vertices[index as usize]));
            }
            indices.push(*slot);
        }
        Ok(Self {
            coords: region.coords,
            vertices,
            indices,
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

    /// The chunk's bytes. Without vertices it removes its region.
    ///
    /// # Errors
    /// The codec refuses the mesh.
    pub fn encode(&self, generation: u32, level: u8) -> Result<Bytes, EncodeError> {
        let fault = |error: meshopt::Error| EncodeError {
            coords: self.coords,
            why: format!("mesh codec: {error}"),
        };
        let (vertex_payload, index_payload) = if self.vertices.is_empty() {
            (Vec::new(), Vec::new())
        } else {
            (
                // The version is named, because its default is a process-wide setting.
                meshopt::encode_vertex_buffer_level(&self.vertices, VERTEX_EFFORT, Some(1)).map_err(fault)?,
                meshopt::encode_index_buffer(&self.indices, self.vertices.len()).map_err(fault)?,
            )
        };
        let (min, max) = self.bounds();
        let [error_rms, error_max] = self.error.unwrap_or([f32::NAN; 2]);
        let header = ChunkHeader {
            generation,
            level,
            region: self.coords,
            min,
            max,
            vertex_count: self.vertices.len() as u32,
            index_count: self.indices.len() as u32,
            vertex_bytes: vertex_payload.len() as u32,
            index_bytes: index_payload.len() as u32,
            level_triangles: self.level_triangles,
            error_rms,
            error_max,
        };
        let mut frame = Vec::with_capacity(HEADER_BYTES + vertex_payload.len() + index_payload.len());
        frame.extend_from_slice(&header.to_bytes());
        frame.extend_from_slice(&vertex_payload);
        frame.extend_from_slice(&index_payload);
        Ok(frame.into())
    }

    /// Least and greatest position in index space.
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        let Some(first) = self.vertices.first() else {
            return ([0.0; 3], [0.0; 3]);
        };
        let (mut min, mut max) = (first.position, first.position);
        for vertex in &self.vertices {
            for axis in 0..3 {
                min[axis] = min[axis].min(vertex.position[axis]);
                max[axis] = max[axis].max(vertex.position[axis]);
            }
        }
        // Through f64: past 2¹⁶ cells a sum in f32 loses the lattice.
        let index = |position: [i16; 3]| {
            [0, 1, 2].map(|axis| {
                let corner = f64::from(self.coords[axis]) * f64::from(REGION_CELLS);
                (corner + f64::from(position[axis]) / f64::from(LATTICE)) as f32
            })
        };
        (index(min), index(max))
    }
}

/// Effort of the vertex codec, 0 to 3: the library's default.
const VERTEX_EFFORT: i32 = 2;

#[cfg(test)]
mod tests;
