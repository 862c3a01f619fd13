//! Quadric simplification of a finished surface (meshoptimizer). The surface stays as closed as it was: vertices are left
//! out, never moved, and those that two blocks share stay where they are. Pure; runs on rayon's pool.

mod block;
mod deviation;
mod distance;
mod locked_vertices;
mod split_sheets;
mod weld;

use isopeel_kernels::{Surface, SurfaceError, Vertex};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use crate::view::View;
use block::{Block, simplify_all};
use deviation::Strayed;
use split_sheets::separate;
use weld::{Triangle, gather, split};

/// A polished surface of N triangles is made from a cut of so many times N: what the cut leaves out is out for good, what
/// it leaves in the simplifier weighs.
pub const SOURCE: u64 = 12;

/// Share of a budget that is aimed at: [`separate()`] takes the rest, on noisy surfaces 3 %.
const ROOM: f64 = 0.96;

/// Trials for a budget that the triangles of [`separate()`] fit in.
const AIMS: usize = 3;

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
    let errors: FxHashMap<[u32; 3], SurfaceError> = (regions.iter())
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

#[cfg(test)]
mod tests;
