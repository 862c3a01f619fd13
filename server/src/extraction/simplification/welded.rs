//! Vertices and triangles of a surface whose regions are joined.

use isopeel_kernels::{REGION_CELLS, Vertex};

use crate::math::DVec3;

/// Lattice units per region.
pub(super) const REGION_LATTICE: i64 = REGION_CELLS as i64 * Vertex::LATTICE as i64;

/// A vertex of the whole surface.
pub(super) struct Welded {
    /// On the lattice of the whole volume.
    pub position: [i64; 3],
    pub vertex: Vertex,
    /// Finest level of its triangles.
    pub level: u8,
    /// The first block that has it.
    pub block: usize,
    /// Whether several blocks have it.
    pub shared: bool,
}

/// A triangle of the whole surface.
#[derive(Clone, Copy)]
pub(super) struct Triangle {
    pub block: u32,
    /// Welded vertices.
    pub corners: [u32; 3],
}

/// Position in world units along the axes of the grid.
pub(super) fn world(welded: &Welded, spacing: [f64; 3]) -> DVec3 {
    DVec3::from(welded.position.map(|p| p as f64)) / f64::from(Vertex::LATTICE) * DVec3::from(spacing)
}

impl Welded {
    /// The vertex after `i` of `n` equal steps from one to another.
    pub(super) fn between(a: &Self, b: &Self, i: i64, n: i64) -> Self {
        let nearer = if 2 * i <= n { a } else { b };
        Self {
            position: [0, 1, 2].map(|axis| (a.position[axis] * (n - i) + b.position[axis] * i).div_euclid(n)),
            vertex: nearer.vertex,
            level: a.level.min(b.level),
            block: nearer.block,
            shared: false,
        }
    }
}
