//! Quadric simplification of a finished surface, by meshoptimizer, which has no notion of blocks, budgets over several blocks, or
//! topology. Added here: blocks in parallel whose common vertices are locked, small parts that must not vanish, sheets that were
//! joined along an edge, and the error of the result. On rayon's pool.
//!
//! A closed surface stays closed: vertices are removed, never moved, and those that two blocks share stay.

mod block;
mod deviation;
mod distance;
mod locked_vertices;
mod split_sheets;
mod weld;
mod welded;

use isopeel_kernels::{Surface, SurfaceError, Vertex};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use tokio_util::sync::CancellationToken;

use crate::view::View;
use block::{Block, simplify_blocks};
use deviation::Deviation;
use split_sheets::split_sheets;
use weld::{gather, weld};
use welded::{Triangle, Welded};

/// A surface is simplified to N triangles from a cut of so many times N. The simplifier chooses better than the cut what to keep,
/// but only from what the cut has left.
pub const SOURCE: u64 = 12;

/// Share of a budget that simplification aims at. [`split_sheets()`] adds triangles, on noisy surfaces 3 %.
const AIMED_SHARE: f64 = 0.96;

/// Maximum number of simplifications until the triangles fit the budget.
const MAX_TRIALS: usize = 3;

/// The blocks of a surface that are simplified one by one, the vertices that they share locked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocks {
    /// Every region: a region that does not change is not sent again.
    Regions,
    /// Cubes of so many regions along each axis: fewer locked vertices.
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

/// When simplification stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// At this many triangles.
    Triangles(u64),
    /// Before a collapse with a larger error, world units.
    Error(f32),
}

/// Importance of a vertex, eq. 3 of the paper.
pub struct Importance {
    alpha: f32,
    /// Positions and importance of the control points, sorted.
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
pub fn simplify(
    surface: Surface,
    spacing: [f64; 3],
    importance: &Importance,
    goal: Goal,
    blocks: Blocks,
    token: &CancellationToken,
) -> Option<Surface> {
    let Surface {
        regions,
        remade,
        prefix,
        mut statistics,
    } = surface;
    let errors: FxHashMap<[u32; 3], SurfaceError> = (regions.iter())
        .filter_map(|region| Some((region.coords, region.error?)))
        .collect();
    let (mut welded, blocks) = weld(regions, spacing, importance, blocks);
    let source = welded.len();
    let triangles = simplify_to_goal(&mut welded, &blocks, goal, spacing, token)?;
    let mut used = vec![false; welded.len()];
    triangles
        .iter()
        .flat_map(|t| t.corners)
        .for_each(|v| used[v as usize] = true);
    statistics.triangles = triangles.len() as u64;
    statistics.vertices = used.iter().filter(|used| **used).count() as u64;
    let mut regions = gather(&welded, &blocks, &triangles);
    if token.is_cancelled() {
        return None;
    }
    if let Some(error) = statistics.error {
        let before: Vec<[u32; 3]> = (blocks.par_iter())
            .flat_map_iter(|block| block.welded_triangles(&block.indices))
            .collect();
        let deviation = Deviation::measure(&welded, source, &before, &triangles, &used, spacing);
        statistics.error = Some(deviation.added_to(error, None));
        for region in &mut regions {
            let source_error = errors.get(&region.coords).copied().unwrap_or(error);
            region.error = Some(deviation.added_to(source_error, Some(region.coords)));
        }
    }
    Some(Surface {
        regions,
        remade,
        prefix,
        statistics,
    })
}

/// Simplifies all blocks and splits the sheets of the result, so that the triangles after the split fit the goal. `None`:
/// cancelled.
fn simplify_to_goal(
    welded: &mut Vec<Welded>,
    blocks: &[Block],
    goal: Goal,
    spacing: [f64; 3],
    token: &CancellationToken,
) -> Option<Vec<Triangle>> {
    let source = welded.len();
    let source_triangles: u64 = blocks.iter().map(|block| block.indices.len() as u64 / 3).sum();
    let mut aim = match goal {
        Goal::Triangles(max) if source_triangles > max => Goal::Triangles((AIMED_SHARE * max as f64) as u64),
        goal => goal,
    };
    let mut triangles = Vec::new();
    for _ in 0..MAX_TRIALS {
        // Each trial starts from the source again: the simplifier would measure the errors of a second pass against the first.
        welded.truncate(source);
        let simplified = simplify_blocks(blocks, aim, token)?;
        triangles = (0u32..)
            .zip(blocks.iter().zip(&simplified))
            .flat_map(|(number, (block, indices))| {
                (block.welded_triangles(indices)).map(move |corners| Triangle { block: number, corners })
            })
            .collect();
        split_sheets(welded, &mut triangles, spacing);
        // Splitting sheets adds triangles, which count for the budget too.
        let (Goal::Triangles(max), Goal::Triangles(aimed)) = (goal, aim) else {
            break;
        };
        let excess = (triangles.len() as u64).saturating_sub(max);
        if excess == 0 {
            break;
        }
        aim = Goal::Triangles(aimed.saturating_sub(excess + excess / 8 + 2));
    }
    Some(triangles)
}

#[cfg(test)]
mod tests;
