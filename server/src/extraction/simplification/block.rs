//! Parts of a surface, each simplified in one go by the library.

use meshopt::{SimplifyOptions, VertexDataAdapter};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use super::locked_vertices::anchors;
use super::weld::{Welded, world};
use super::{Goal, Importance};
use crate::math::DVec3;

/// What a normal that is off by one unit costs, in multiples of the smallest spacing. Enough that shading stays, too
/// little to cost distance.
const NORMAL_WEIGHT: f32 = 0.05;
/// How much more normals count where importance is 1 than where it is 0: what the user called important stays.
const IMPORTANCE_GAIN: f32 = 4.0;

/// Trials for one error that gives the wanted number of triangles in all blocks together.
const TRIALS: usize = 8;

/// A part of the surface with its own vertices.
pub(super) struct Block {
    /// Region that it is, where it is one.
    pub region: Option<[u32; 3]>,
    /// Its vertices among the welded.
    pub vertices: Vec<u32>,
    /// In world units along the grid's axes, from its first vertex.
    positions: Vec<[f32; 3]>,
    /// Weighted normals, three a vertex.
    normals: Vec<f32>,
    locked: Vec<bool>,
    /// Three a triangle, among its own vertices.
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
        for anchor in anchors(&positions, &indices) {
            locked[anchor as usize] = true;
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

    /// Indices with at most so many triangles, or as far as the error goes, world units. What the library refuses stays
    /// as it is.
    fn simplify(&self, triangles: usize, error: f32) -> Vec<u32> {
        if self.indices.is_empty() || self.extent <= 0.0 {
            return self.indices.clone();
        }
        let Ok(vertices) = VertexDataAdapter::new(bytemuck::cast_slice(&self.positions), 12, 0) else {
            return self.indices.clone();
        };
        // The library measures attributes in multiples of the extent.
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

/// Simplifies all blocks to one goal: with more than one block, to one error that gives the number of triangles.
pub(super) fn simplify_all(parts: &[Block], goal: Goal, token: &CancellationToken) -> Option<Vec<Vec<u32>>> {
    let all = |triangles: usize, error: f32| -> Option<Vec<Vec<u32>>> {
        let simplify = |part: &Block| (!token.is_cancelled()).then(|| part.simplify(triangles, error));
        parts.par_iter().map(simplify).collect()
    };
    let wanted = match goal {
        Goal::Error(error) => return all(0, error),
        Goal::Triangles(n) => n,
    };
    let held: u64 = parts.iter().map(|part| part.indices.len() as u64 / 3).sum();
    if held <= wanted {
        return Some(parts.iter().map(|part| part.indices.clone()).collect());
    }
    if parts.len() == 1 {
        return all(wanted as usize, f32::MAX);
    }
    let count = |simplified: &[Vec<u32>]| simplified.iter().map(|indices| indices.len() as u64 / 3).sum::<u64>();
    let extent = parts.iter().map(|part| part.extent).fold(0.0, f32::max);
    // Between next to nothing and everything, on a logarithmic scale.
    let (mut low, mut high) = ((extent * 1e-6).ln(), extent.ln());
    let mut best = all(0, f32::MAX)?;
    if count(&best) > wanted {
        return Some(best);
    }
    for _ in 0..TRIALS {
        let error = (low + high) / 2.0;
        let tried = all(0, error.exp())?;
        let n = count(&tried);
        if n > wanted {
            low = error;
        } else {
            high = error;
            if n > count(&best) {
                best = tried;
            }
            if n as f64 >= 0.98 * wanted as f64 {
                break;
            }
        }
    }
    Some(best)
}
