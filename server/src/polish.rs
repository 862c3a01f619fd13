//! Quadric simplification of a finished surface (meshoptimizer). The surface stays as closed as it was: vertices are
//! only ever left out, never moved, and those that two blocks share stay where they are. Pure; runs on rayon's pool.

use std::collections::HashMap;

use isopeel_kernels::{REGION_CELLS, Region, Surface, Vertex};
use meshopt::{SimplifyOptions, VertexDataAdapter};
use rayon::prelude::*;
use tokio_util::sync::CancellationToken;

use crate::edit::View;

/// A polished surface of N triangles is made from a cut of so many times N: what the cut leaves out is out for good, what
/// it leaves in the simplifier weighs.
pub const SOURCE: u64 = 4;

/// What a normal that is off by one unit costs, in multiples of the smallest spacing. Enough that shading stays, too
/// little to cost distance.
const NORMAL_WEIGHT: f32 = 0.05;
/// How much more normals count where importance is 1 than where it is 0: what the user called important stays.
const IMPORTANCE_GAIN: f32 = 4.0;

/// Times that places are locked where the simplifier joined what was apart; the radius doubles each time.
const REPAIRS: usize = 6;

/// Trials for one error that gives the wanted number of triangles in all blocks together.
const TRIALS: usize = 8;

/// Lattice units per region.
const REGION_LATTICE: i64 = REGION_CELLS as i64 * Vertex::LATTICE as i64;

/// What is simplified in one go, its border locked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocks {
    /// Every region alone: what does not change is not sent again.
    Regions,
    /// Cubes of so many regions: fewer vertices on borders.
    Cubes(u32),
}

impl Blocks {
    /// For files: 256³ cells.
    pub const EXPORT: Self = Self::Cubes(8);

    fn of(self, region: [u32; 3]) -> [u32; 3] {
        match self {
            Self::Regions => region,
            Self::Cubes(n) => region.map(|c| c / n.max(1)),
        }
    }
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// At so many triangles.
    Triangles(u64),
    /// Where a collapse would be off by more, world units.
    Error(f32),
}

/// Importance of a vertex, eq. 3.
pub struct Importance {
    alpha: f32,
    /// Over x, sorted.
    points: Vec<(f32, f32)>,
}

impl Importance {
    /// Of a view's α and transfer function.
    pub fn new(view: &View) -> Self {
        let mut points: Vec<_> = view
            .transfer_function
            .points
            .iter()
            .map(|p| (p.x, p.importance))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            alpha: view.alpha,
            points,
        }
    }

    fn of(&self, vertex: &Vertex) -> f32 {
        let s = f32::from(vertex.smoothness) / 65535.0;
        let f = f32::from(vertex.feature) / 65535.0;
        let x = (1.0 - self.alpha) * s + self.alpha * f;
        match self.points.partition_point(|p| p.0 <= x) {
            0 => self.points.first().map_or(x, |p| p.1),
            n if n == self.points.len() => self.points[n - 1].1,
            n => {
                let ((x0, y0), (x1, y1)) = (self.points[n - 1], self.points[n]);
                y0 + (y1 - y0) * (x - x0) / (x1 - x0)
            }
        }
    }
}

/// A vertex of the whole surface.
struct Welded {
    /// On the lattice of the whole volume.
    position: [i64; 3],
    vertex: Vertex,
    /// Finest level of its triangles.
    level: u8,
    /// Block that it was seen in first.
    block: usize,
    /// More than one block has it.
    shared: bool,
}

/// A part of the surface with its own vertices.
struct Block {
    /// Region that it is, where it is one.
    region: Option<[u32; 3]>,
    /// Its vertices among the welded.
    vertices: Vec<u32>,
    /// In world units along the grid's axes, from its first vertex.
    positions: Vec<[f32; 3]>,
    /// Weighted normals, three a vertex.
    normals: Vec<f32>,
    locked: Vec<bool>,
    /// Three a triangle, among its own vertices.
    indices: Vec<u32>,
    extent: f32,
}

/// Simplifies a surface; `None`: cancelled. `spacing` in world units.
pub fn polish(
    surface: Surface,
    spacing: [f64; 3],
    importance: &Importance,
    goal: Goal,
    blocks: Blocks,
    token: &CancellationToken,
) -> Option<Surface> {
    let Surface {
        regions,
        prefix,
        mut statistics,
    } = surface;
    let (welded, mut parts) = split(regions, spacing, importance, blocks);
    let pinched: Vec<_> = pinched_edges(parts.iter().map(|part| (part, part.indices.as_slice())));
    let unit = spacing.into_iter().fold(f64::INFINITY, f64::min) as f32;
    let mut radius = 2.0 * unit;
    let mut simplified = simplify_all(&parts, goal, token)?;
    for _ in 0..REPAIRS {
        let joined = pinched_edges(
            parts
                .iter()
                .zip(&simplified)
                .map(|(part, indices)| (part, indices.as_slice())),
        );
        let new: Vec<_> = joined
            .iter()
            .filter(|edge| pinched.binary_search(edge).is_err())
            .collect();
        if new.is_empty() {
            break;
        }
        let ends: Vec<_> = new
            .iter()
            .flat_map(|edge| [edge.0, edge.1])
            .map(|v| world(&welded[v as usize], spacing))
            .collect();
        parts
            .par_iter_mut()
            .for_each(|part| part.lock_near(&ends, radius, &welded, spacing));
        simplified = simplify_all(&parts, goal, token)?;
        radius *= 2.0;
    }
    let regions = gather(&welded, &parts, &simplified);
    let mut used = vec![false; welded.len()];
    for (part, indices) in parts.iter().zip(&simplified) {
        indices
            .iter()
            .for_each(|&i| used[part.vertices[i as usize] as usize] = true);
    }
    statistics.triangles = simplified.iter().map(|indices| indices.len() as u64 / 3).sum();
    statistics.vertices = used.iter().filter(|used| **used).count() as u64;
    // That of the surface it was made from, which this one is not.
    statistics.error = None;
    Some(Surface {
        regions,
        prefix,
        statistics,
    })
}

fn world(welded: &Welded, spacing: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| welded.position[axis] as f64 / f64::from(Vertex::LATTICE) * spacing[axis])
}

/// Joins vertices at the same place and hands the triangles out to blocks.
fn split(
    regions: Vec<Region>,
    spacing: [f64; 3],
    importance: &Importance,
    blocks: Blocks,
) -> (Vec<Welded>, Vec<Block>) {
    let mut welded: Vec<Welded> = Vec::new();
    let mut at: HashMap<[i64; 3], u32> = HashMap::new();
    let mut block_at: HashMap<[u32; 3], usize> = HashMap::new();
    let mut triangles: Vec<(Option<[u32; 3]>, Vec<[u32; 3]>)> = Vec::new();
    for region in regions {
        let next = triangles.len();
        let block = *block_at.entry(blocks.of(region.coords)).or_insert(next);
        if block == next {
            triangles.push(((blocks == Blocks::Regions).then_some(region.coords), Vec::new()));
        }
        let corner = region.coords.map(|c| i64::from(c) * REGION_LATTICE);
        let joined: Vec<u32> = (region.vertices.iter())
            .map(|vertex| {
                let position = [0, 1, 2].map(|axis| corner[axis] + i64::from(vertex.position[axis]));
                let index = *at.entry(position).or_insert(welded.len() as u32);
                if index as usize == welded.len() {
                    welded.push(Welded {
                        position,
                        vertex: *vertex,
                        level: u8::MAX,
                        block,
                        shared: false,
                    });
                }
                index
            })
            .collect();
        let levels = (0u8..)
            .zip(region.level_triangles)
            .flat_map(|(level, n)| std::iter::repeat_n(level, n as usize));
        for (corners, level) in region.indices.chunks_exact(3).zip(levels) {
            let triangle = [0, 1, 2].map(|i| joined[corners[i] as usize]);
            for v in triangle {
                let v = &mut welded[v as usize];
                v.level = v.level.min(level);
                v.shared |= v.block != block;
            }
            let [a, b, c] = triangle;
            if a != b && b != c && c != a {
                triangles[block].1.push(triangle);
            }
        }
    }
    let parts = triangles
        .into_par_iter()
        .map(|(region, triangles)| Block {
            region,
            ..Block::new(&triangles, &welded, spacing, importance)
        })
        .collect();
    (welded, parts)
}

impl Block {
    fn new(triangles: &[[u32; 3]], welded: &[Welded], spacing: [f64; 3], importance: &Importance) -> Self {
        let mut own: HashMap<u32, u32> = HashMap::new();
        let mut vertices = Vec::new();
        let indices = (triangles.iter().flatten())
            .map(|&v| {
                *own.entry(v).or_insert_with(|| {
                    vertices.push(v);
                    vertices.len() as u32 - 1
                })
            })
            .collect();
        let origin = vertices
            .first()
            .map_or([0.0; 3], |&v| world(&welded[v as usize], spacing));
        let positions: Vec<[f32; 3]> = (vertices.iter())
            .map(|&v| {
                let world = world(&welded[v as usize], spacing);
                [0, 1, 2].map(|axis| (world[axis] - origin[axis]) as f32)
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
        Self {
            region: None,
            locked: vertices.iter().map(|&v| welded[v as usize].shared).collect(),
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

    fn lock_near(&mut self, places: &[[f64; 3]], radius: f32, welded: &[Welded], spacing: [f64; 3]) {
        let limit = f64::from(radius).powi(2);
        for (locked, &v) in self.locked.iter_mut().zip(&self.vertices) {
            let here = world(&welded[v as usize], spacing);
            *locked |= places.iter().any(|p| {
                let d = [0, 1, 2].map(|axis| p[axis] - here[axis]);
                d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= limit
            });
        }
    }
}

/// Simplifies all blocks to one goal: with more than one block, to one error that gives the number of triangles.
fn simplify_all(parts: &[Block], goal: Goal, token: &CancellationToken) -> Option<Vec<Vec<u32>>> {
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

/// Edges of more than two triangles, sorted, as welded vertices.
fn pinched_edges<'a>(parts: impl Iterator<Item = (&'a Block, &'a [u32])>) -> Vec<(u32, u32)> {
    let mut edges = Vec::new();
    for (part, indices) in parts {
        for t in indices.chunks_exact(3) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let (a, b) = (part.vertices[a as usize], part.vertices[b as usize]);
                edges.push((a.min(b), a.max(b)));
            }
        }
    }
    edges.par_sort_unstable();
    let mut pinched: Vec<_> = edges.windows(3).filter(|w| w[0] == w[2]).map(|w| w[0]).collect();
    pinched.dedup();
    pinched
}

/// Regions again: a triangle goes to the region of its block, or, where that has several, to that of its centre.
fn gather(welded: &[Welded], parts: &[Block], simplified: &[Vec<u32>]) -> Vec<Region> {
    let mut triangles: HashMap<[u32; 3], Vec<(u8, [u32; 3])>> = HashMap::new();
    for (part, indices) in parts.iter().zip(simplified) {
        for t in indices.chunks_exact(3) {
            let corners = [0, 1, 2].map(|i| part.vertices[t[i] as usize]);
            let at = |axis: usize| corners.map(|v| welded[v as usize].position[axis]).iter().sum::<i64>() / 3;
            let centre = || [0, 1, 2].map(|axis| at(axis).div_euclid(REGION_LATTICE).max(0) as u32);
            let coords = part.region.unwrap_or_else(centre);
            let level = corners.iter().map(|&v| welded[v as usize].level).min().unwrap_or(0);
            triangles.entry(coords).or_default().push((level, corners));
        }
    }
    let mut regions: Vec<Region> = (triangles.into_par_iter())
        .map(|(coords, mut triangles)| {
            triangles.sort_by_key(|t| t.0);
            let corner = coords.map(|c| i64::from(c) * REGION_LATTICE);
            let mut region = Region {
                coords,
                ..Region::default()
            };
            let mut own: HashMap<u32, u32> = HashMap::new();
            for (level, corners) in triangles {
                region.level_triangles[usize::from(level.min(5))] += 1;
                for v in corners {
                    let index = *own.entry(v).or_insert_with(|| {
                        let Welded { position, vertex, .. } = &welded[v as usize];
                        let position = [0, 1, 2].map(|axis| (position[axis] - corner[axis]) as i32);
                        region.vertices.push(Vertex { position, ..*vertex });
                        region.vertices.len() as u32 - 1
                    });
                    region.indices.push(index);
                }
            }
            region
        })
        .collect();
    regions.sort_by_key(|region| [region.coords[2], region.coords[1], region.coords[0]]);
    regions
}
