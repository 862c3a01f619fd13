//! Quadric simplification of a finished surface (meshoptimizer). The surface stays as closed as it was: vertices are left
//! out, never moved, and those that two blocks share stay where they are. Pure; runs on rayon's pool.

mod anchors;
mod distance;
mod strayed;

use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

use isopeel_kernels::{REGION_CELLS, Region, Surface, SurfaceError, Vertex};
use meshopt::{SimplifyOptions, VertexDataAdapter};
use rayon::prelude::*;
use tokio_util::sync::CancellationToken;

use crate::edit::View;
use crate::export::mesh::{cross, dot};
use anchors::anchors;
use strayed::Strayed;

/// A polished surface of N triangles is made from a cut of so many times N: what the cut leaves out is out for good, what
/// it leaves in the simplifier weighs.
pub const SOURCE: u64 = 12;

/// What a normal that is off by one unit costs, in multiples of the smallest spacing. Enough that shading stays, too
/// little to cost distance.
const NORMAL_WEIGHT: f32 = 0.05;
/// How much more normals count where importance is 1 than where it is 0: what the user called important stays.
const IMPORTANCE_GAIN: f32 = 4.0;

/// Rounds of [`separate`]; a triangle with several joined edges takes part in one of them a round.
const SEPARATIONS: usize = 16;

/// Share of a budget that is aimed at: [`separate`] takes the rest, on noisy surfaces 3 %.
const ROOM: f64 = 0.96;

/// Trials for a budget that the triangles of [`separate`] fit in.
const AIMS: usize = 3;

/// Trials for one error that gives the wanted number of triangles in all blocks together.
const TRIALS: usize = 8;

/// Numbers and places as keys: the standard hash, made for keys that an enemy chooses, does more than is needed here.
#[derive(Default)]
struct Mixed(u64);

impl Hasher for Mixed {
    fn write(&mut self, bytes: &[u8]) {
        for eight in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..eight.len()].copy_from_slice(eight);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u32(&mut self, word: u32) {
        self.write_u64(word.into());
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(23) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }
}

type HashMap<K, V> = std::collections::HashMap<K, V, BuildHasherDefault<Mixed>>;

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

/// The region that a block is, where it is one, and its triangles among the welded vertices.
type BlockTriangles = (Option<[u32; 3]>, Vec<[u32; 3]>);

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

/// A triangle of the whole surface.
#[derive(Clone, Copy)]
struct Triangle {
    block: u32,
    /// Welded vertices.
    corners: [u32; 3],
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
    let errors: HashMap<[u32; 3], SurfaceError> = (regions.iter())
        .filter_map(|region| Some((region.coords, region.error?)))
        .collect();
    let (mut welded, parts) = split(regions, spacing, importance, blocks);
    let source = welded.len();
    let of_part = |part: &Block, indices: &[u32]| -> Vec<[u32; 3]> {
        let corner = |i: &u32| part.vertices[*i as usize];
        indices
            .chunks_exact(3)
            .map(|t| [corner(&t[0]), corner(&t[1]), corner(&t[2])])
            .collect()
    };
    let held: u64 = parts.iter().map(|part| part.indices.len() as u64 / 3).sum();
    let before: Vec<[u32; 3]> = parts
        .par_iter()
        .flat_map_iter(|part| of_part(part, &part.indices))
        .collect();
    // Not on from what was simplified: it no longer knows what it is to be near to.
    let mut aim = match goal {
        Goal::Triangles(wanted) if held > wanted => Goal::Triangles((ROOM * wanted as f64) as u64),
        goal => goal,
    };
    let mut triangles = Vec::new();
    for _ in 0..AIMS {
        welded.truncate(source);
        let simplified = simplify_all(&parts, aim, token)?;
        triangles = (0u32..)
            .zip(parts.iter().zip(&simplified))
            .flat_map(|(block, (part, indices))| {
                of_part(part, indices)
                    .into_iter()
                    .map(move |corners| Triangle { block, corners })
            })
            .collect();
        separate(&mut welded, &mut triangles, spacing);
        // Parting sheets takes triangles, which a budget has to hold too.
        let (Goal::Triangles(wanted), Goal::Triangles(aimed)) = (goal, aim) else {
            break;
        };
        let over = (triangles.len() as u64).saturating_sub(wanted);
        if over == 0 {
            break;
        }
        aim = Goal::Triangles(aimed.saturating_sub(over + over / 8 + 2));
    }
    let mut used = vec![false; welded.len()];
    triangles
        .iter()
        .flat_map(|t| t.corners)
        .for_each(|v| used[v as usize] = true);
    statistics.triangles = triangles.len() as u64;
    statistics.vertices = used.iter().filter(|used| **used).count() as u64;
    let mut regions = gather(&welded, &parts, triangles.clone());
    if token.is_cancelled() {
        return None;
    }
    if let Some(error) = statistics.error {
        let strayed = Strayed::measure(&welded, source, &before, &triangles, &used, spacing);
        statistics.error = Some(strayed.added_to(error, None));
        for region in &mut regions {
            let before = errors.get(&region.coords).copied().unwrap_or(error);
            region.error = Some(strayed.added_to(before, Some(region.coords)));
        }
    }
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
    let mut at: HashMap<[i64; 3], u32> = HashMap::default();
    let mut block_at: HashMap<[u32; 3], usize> = HashMap::default();
    let mut triangles: Vec<BlockTriangles> = Vec::new();
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
        let mut own: HashMap<u32, u32> = HashMap::default();
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
        let mut locked: Vec<bool> = vertices.iter().map(|&v| welded[v as usize].shared).collect();
        for anchor in anchors(&positions, &indices) {
            locked[anchor as usize] = true;
        }
        Self {
            region: None,
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

/// An edge's lesser end, then its greater.
fn edge_key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

/// Parts sheets that the simplifier joined along an edge. It collapses edges without asking whether their ends have
/// neighbours in common that no triangle holds (the link condition), so a thin neck ends as one edge with four triangles.
/// Each sheet but one gets a vertex of its own on that edge: no point of the surface moves.
fn separate(welded: &mut Vec<Welded>, triangles: &mut Vec<Triangle>, spacing: [f64; 3]) {
    // After the first round only the edges that it left, and those it made, have to be looked at.
    let mut left: Option<HashSet<u64, BuildHasherDefault<Mixed>>> = None;
    for _ in 0..SEPARATIONS {
        let mut edges: Vec<(u64, u32)> = (triangles.par_iter().enumerate())
            .flat_map_iter(|(t, triangle)| {
                let [a, b, c] = triangle.corners;
                [(a, b), (b, c), (c, a)].map(|(a, b)| (edge_key(a, b), t as u32))
            })
            .filter(|(edge, _)| left.as_ref().is_none_or(|left| left.contains(edge)))
            .collect();
        edges.par_sort_unstable();
        let mut touched = HashSet::new();
        let mut next = HashSet::default();
        for edge in edges.chunk_by(|a, b| a.0 == b.0).filter(|edge| edge.len() > 2) {
            // A triangle that was cut in this round is elsewhere now.
            if edge.iter().any(|e| touched.contains(&e.1)) {
                next.insert(edge[0].0);
                continue;
            }
            touched.extend(edge.iter().map(|e| e.1));
            let (a, b) = ((edge[0].0 >> 32) as u32, edge[0].0 as u32);
            let sheets = sheets(edge.iter().map(|e| e.1), [a, b], welded, triangles, spacing);
            let count = sheets.len();
            for (i, sheet) in sheets.into_iter().enumerate().skip(1) {
                let middle = welded.len() as u32;
                welded.push(Welded::between(
                    &welded[a as usize],
                    &welded[b as usize],
                    i as i64,
                    count as i64,
                ));
                for t in sheet {
                    let Triangle { block, corners } = triangles[t as usize];
                    let with = |old: u32| corners.map(|v| if v == old { middle } else { v });
                    triangles[t as usize].corners = with(a);
                    triangles.push(Triangle {
                        block,
                        corners: with(b),
                    });
                    next.extend(corners.map(|v| edge_key(v, middle)));
                }
            }
        }
        if next.is_empty() {
            break;
        }
        left = Some(next);
    }
}

/// Pairs the triangles of an edge: the two of a sheet run along it in opposite directions and turn least. One that is left
/// over ends there: the border of a surface that leaves the volume.
fn sheets(
    around: impl Iterator<Item = u32>,
    [a, b]: [u32; 2],
    welded: &[Welded],
    triangles: &[Triangle],
    spacing: [f64; 3],
) -> Vec<Vec<u32>> {
    let forward = |t: u32| {
        let [x, y, z] = triangles[t as usize].corners;
        [(x, y), (y, z), (z, x)].contains(&(a, b))
    };
    let normal = |t: u32| {
        let [x, y, z] = triangles[t as usize]
            .corners
            .map(|v| world(&welded[v as usize], spacing));
        let sides = [y, z].map(|p| [0, 1, 2].map(|axis| p[axis] - x[axis]));
        let n = cross(sides[0], sides[1]);
        let length = dot(n, n).sqrt().max(f64::MIN_POSITIVE);
        n.map(|v| v / length)
    };
    let (ahead, mut back): (Vec<u32>, Vec<u32>) = around.partition(|&t| forward(t));
    let mut sheets = Vec::new();
    for t in ahead {
        let n = normal(t);
        let turn = |&(_, &other): &(usize, &u32)| dot(n, normal(other));
        let partner = back.iter().enumerate().max_by(|x, y| turn(x).total_cmp(&turn(y)));
        sheets.push(match partner.map(|(at, _)| at) {
            Some(at) => vec![t, back.swap_remove(at)],
            None => vec![t],
        });
    }
    sheets.extend(back.into_iter().map(|t| vec![t]));
    sheets
}

impl Welded {
    /// The vertex at `i` of `n` steps from one to another.
    fn between(a: &Self, b: &Self, i: i64, n: i64) -> Self {
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

/// Regions again: a triangle goes to the region of its block, or, where that has several, to that of its centre.
fn gather(welded: &[Welded], parts: &[Block], all: Vec<Triangle>) -> Vec<Region> {
    let mut triangles: HashMap<[u32; 3], Vec<(u8, [u32; 3])>> = HashMap::default();
    for Triangle { block, corners } in all {
        let at = |axis: usize| corners.map(|v| welded[v as usize].position[axis]).iter().sum::<i64>() / 3;
        let centre = || [0, 1, 2].map(|axis| at(axis).div_euclid(REGION_LATTICE).max(0) as u32);
        let coords = parts[block as usize].region.unwrap_or_else(centre);
        let level = corners.iter().map(|&v| welded[v as usize].level).min().unwrap_or(0);
        triangles.entry(coords).or_default().push((level, corners));
    }
    let mut regions: Vec<Region> = (triangles.into_par_iter())
        .map(|(coords, mut triangles)| {
            triangles.sort_by_key(|t| t.0);
            let corner = coords.map(|c| i64::from(c) * REGION_LATTICE);
            let mut region = Region {
                coords,
                ..Region::default()
            };
            let mut own: HashMap<u32, u32> = HashMap::default();
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

#[cfg(test)]
mod tests;
