//! Blocks of a surface, each a mesh of its own for the simplifier.

use meshopt::{SimplifyOptions, VertexDataAdapter};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use super::locked_vertices::spanning_vertices;
use super::welded::{Welded, world};
use super::{Goal, Importance};
use crate::math::DVec3;

/// Weight of a normal in the simplifier's error, in multiples of the smallest spacing: enough to preserve shading, too little to
/// increase distances.
const NORMAL_WEIGHT: f32 = 0.05;
/// Added weight of normals where importance is 1, relative to where it is 0.
const IMPORTANCE_GAIN: f32 = 4.0;

/// Maximum steps of the search for the error at which all blocks together have the number of triangles of the goal.
const MAX_STEPS: usize = 8;

/// A block with its own vertices.
pub(super) struct Block {
    /// Its region, where blocks are regions.
    pub region: Option<[u32; 3]>,
    /// The welded vertex of each of its own.
    pub vertices: Vec<u32>,
    /// World units along the grid's axes, relative to its first vertex.
    positions: Vec<[f32; 3]>,
    /// Weighted normals, three a vertex.
    normals: Vec<f32>,
    locked: Vec<bool>,
    /// Three per triangle, of its own vertices.
    pub indices: Vec<u32>,
    extent: f32,
}

impl Block {
    pub(super) fn new(
        region: Option<[u32; 3]>,
        triangles: &[[u32; 3]],
        welded: &[Welded],
        spacing: [f64; 3],
        importance: &Importance,
    ) -> Self {
        let mut own: FxHashMap<u32, u32> = FxHashMap::default();
        let mut vertices = Vec::new();
        let indices: Vec<u32> = (triangles.iter().flatten())
            .map(|&v| {
                *own.entry(v).or_insert_with(|| {
                    vertices.push(v);
                    vertices.len() as u32 - 1
                })
            })
            .collect();
        let origin = vertices
            .first()
            .map_or(DVec3::ZERO, |&v| world(&welded[v as usize], spacing));
        let positions: Vec<[f32; 3]> = (vertices.iter())
            .map(|&v| {
                (world(&welded[v as usize], spacing) - origin)
                    .to_array()
                    .map(|p| p as f32)
            })
            .collect();
        let extent = (0..3)
            .map(|axis| {
                let values = || positions.iter().map(|p| p[axis]);
                values().fold(f32::NEG_INFINITY, f32::max) - values().fold(f32::INFINITY, f32::min)
            })
            .fold(0.0, f32::max);
        let unit = spacing.into_iter().fold(f64::INFINITY, f64::min) as f32;
        let normals = (vertices.iter())
            .flat_map(|&v| {
                let vertex = &welded[v as usize].vertex;
                let weight = NORMAL_WEIGHT * unit * (1.0 + IMPORTANCE_GAIN * importance.of(vertex));
                vertex.unit_normal().map(|n| n * weight)
            })
            .collect();
        let mut locked: Vec<bool> = vertices.iter().map(|&v| welded[v as usize].shared).collect();
        for vertex in spanning_vertices(&positions, &indices) {
            locked[vertex as usize] = true;
        }
        Self {
            region,
            locked,
            vertices,
            positions,
            normals,
            indices,
            extent,
        }
    }

    /// Triangles of its own vertices by welded vertices.
    pub(super) fn welded_triangles(&self, indices: &[u32]) -> impl Iterator<Item = [u32; 3]> {
        let triangles = indices.as_chunks::<3>().0.iter();
        triangles.map(|triangle| triangle.map(|v| self.vertices[v as usize]))
    }

    /// Indices of at most so many triangles, or as few as the error allows, world units. A block that the library refuses stays
    /// as it is.
    fn simplify(&self, triangles: usize, error: f32) -> Vec<u32> {
        if self.indices.is_empty() || self.extent <= 0.0 {
            return self.indices.clone();
        }
        let Ok(vertices) = VertexDataAdapter::new(bytemuck::cast_slice(&self.positions), 12, 0) else {
            return self.indices.clone();
        };
        // The library scales positions by the extent, but not attributes.
        let weight = 1.0 / self.extent;
        meshopt::simplify_with_attributes_and_locks(
            &self.indices,
            &vertices,
            &self.normals,
            &[weight; 3],
            12,
            &self.locked,
            triangles * 3,
            error,
            SimplifyOptions::ErrorAbsolute,
            None,
        )
    }
}

/// Simplifies all blocks to one goal. A number of triangles becomes an error that all blocks share, found by bisection, so that
/// triangles go where the surface needs them. `None`: cancelled.
pub(super) fn simplify_blocks(blocks: &[Block], goal: Goal, token: &CancellationToken) -> Option<Vec<Vec<u32>>> {
    let all = |triangles: usize, error: f32| -> Option<Vec<Vec<u32>>> {
        let simplify = |block: &Block| (!token.is_cancelled()).then(|| block.simplify(triangles, error));
        blocks.par_iter().map(simplify).collect()
    };
    let max_triangles = match goal {
        Goal::Error(error) => return all(0, error),
        Goal::Triangles(n) => n,
    };
    let source_triangles: u64 = blocks.iter().map(|block| block.indices.len() as u64 / 3).sum();
    if source_triangles <= max_triangles {
        return Some(blocks.iter().map(|block| block.indices.clone()).collect());
    }
    if blocks.len() == 1 {
        return all(max_triangles as usize, f32::MAX);
    }
    let count = |simplified: &[Vec<u32>]| simplified.iter().map(|indices| indices.len() as u64 / 3).sum::<u64>();
    let extent = blocks.iter().map(|block| block.extent).fold(0.0, f32::max);
    // Bisection on a logarithmic scale, between almost no error and the extent.
    let (mut low, mut high) = ((extent * 1e-6).ln(), extent.ln());
    let mut best = all(0, f32::MAX)?;
    if count(&best) > max_triangles {
        return Some(best);
    }
    for _ in 0..MAX_STEPS {
        let error = (low + high) / 2.0;
        let tried = all(0, error.exp())?;
        let n = count(&tried);
        if n > max_triangles {
            low = error;
        } else {
            high = error;
            if n > count(&best) {
                best = tried;
            }
            if n as f64 >= 0.98 * max_triangles as f64 {
                break;
            }
        }
    }
    Some(best)
}
