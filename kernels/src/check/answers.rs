//! What the check's steps must find, and how a finding is compared with it.

use super::Finding;
use crate::{Histogram, Surface, Vertex};
use std::collections::HashMap;

/// Values that depend on the compiler's rounding differ by less than this share.
const ROUNDING: f64 = 1e-2;

/// Of the surface.
pub(super) const ISOVALUE: f32 = 40.0;

/// The largest value, also of the upper end of the histogram.
pub(super) const VALUE_END: u32 = 120;

/// Cubes of an importance up to this are decimated.
pub(super) const BETA: f32 = 0.05;

pub(super) const ACTIVE_BRICKS: u64 = 51;
/// Of marching cubes.
pub(super) const FULL_TRIANGLES: u64 = 6260;
pub(super) const BUDGET: u64 = 2000;
pub(super) const FITTED_TRIANGLES: u64 = 1968;
pub(super) const FULL: Known = Known {
    triangles: 6264,
    vertices: 3134,
    open_edges: 0,
    euler: 2,
    volume: -8739.66,
};
pub(super) const DECIMATED: Known = Known {
    triangles: 280,
    vertices: 142,
    open_edges: 0,
    euler: 2,
    volume: -8554.22,
};
pub(super) const TREE_BUDGET: u64 = 1500;
pub(super) const TREE: Known = Known {
    triangles: 1480,
    vertices: 742,
    open_edges: 0,
    euler: 2,
    volume: -8742.87,
};
pub(super) const MARCHED: [u64; 2] = [276, 165];
pub(super) const LEAVES: [u64; 2] = [3134, 3097];
pub(super) const CURVE_END: u64 = 16;
pub(super) const ERROR: [f32; 2] = [0.1413226, 0.52628386];
pub(super) const TREE_ERROR: f32 = 0.0286;
pub(super) const PROBED: [f32; 2] = [0.486036, 2085.75];
pub(super) const VERTEX_DISTANCE: f32 = 0.3824996;
pub(super) const CORNER_DISTANCE: f32 = 29.4788;
/// Lower and upper end, and mean number of a bin.
pub(super) const GRADIENT: [f32; 3] = [0.0, 13.4257, 122.821];
pub(super) const VARIANCE: [f32; 3] = [0.0, 82.6859, 113.234];
pub(super) const UNEVEN_GRADIENT: [f32; 3] = [0.0, 13.2104, 104.563];

/// What is known of a surface.
pub(super) struct Known {
    pub triangles: u64,
    pub vertices: u64,
    /// Edges that do not belong to two triangles of opposite directions.
    open_edges: u64,
    /// Vertices - edges + triangles.
    euler: i64,
    /// Volume that it encloses, in cells; negative, as triangles are counter-clockwise seen from the lower values inside.
    volume: f64,
}

impl Known {
    pub fn check(&self, surface: &Surface) -> Result<(), Finding> {
        exact("number of triangles", surface.statistics.triangles, self.triangles)?;
        exact("number of vertices", surface.statistics.vertices, self.vertices)?;
        let found = Self::of(surface);
        exact("number of triangles that were made", found.triangles, self.triangles)?;
        exact("number of vertices that were made", found.vertices, self.vertices)?;
        exact("number of open edges", found.open_edges, self.open_edges)?;
        exact("Euler characteristic", found.euler, self.euler)?;
        near("volume inside", found.volume as f32, self.volume as f32)
    }

    fn of(surface: &Surface) -> Self {
        let mut numbers = HashMap::new();
        let mut edges: HashMap<(usize, usize), i64> = HashMap::new();
        let (mut triangles, mut volume) = (0, 0.0);
        for region in &surface.regions {
            let low = region.coords.map(|c| c as i32 * 32 * Vertex::LATTICE);
            let position = |index: u32| {
                let vertex = &region.vertices[index as usize];
                std::array::from_fn::<i32, 3, _>(|axis| low[axis] + vertex.position[axis])
            };
            for corners in region.indices.chunks_exact(3) {
                let p = [position(corners[0]), position(corners[1]), position(corners[2])];
                let at = p.map(|p| {
                    let next = numbers.len();
                    *numbers.entry(p).or_insert(next)
                });
                for i in 0..3 {
                    let (from, to) = (at[i], at[(i + 1) % 3]);
                    *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
                }
                let [a, b, c] = p.map(|p| p.map(|x| f64::from(x) / f64::from(Vertex::LATTICE)));
                volume += (a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0]))
                    / 6.0;
                triangles += 1;
            }
        }
        Self {
            triangles,
            vertices: numbers.len() as u64,
            open_edges: edges.values().filter(|&&balance| balance != 0).count() as u64,
            euler: numbers.len() as i64 - edges.len() as i64 + triangles as i64,
            volume,
        }
    }
}

pub(super) fn exact<T: PartialEq + std::fmt::Debug>(what: &'static str, found: T, expected: T) -> Result<(), Finding> {
    if found == expected {
        return Ok(());
    }
    Err(Finding::Differs {
        what,
        found: format!("{found:?}"),
        expected: format!("{expected:?}"),
    })
}

pub(super) fn near(what: &'static str, found: f32, expected: f32) -> Result<(), Finding> {
    if (f64::from(found) - f64::from(expected)).abs() <= ROUNDING * f64::from(expected).abs() {
        return Ok(());
    }
    Err(Finding::Differs {
        what,
        found: found.to_string(),
        expected: expected.to_string(),
    })
}

/// Compares a histogram's range and the mean of its bins' numbers.
pub(super) fn near_histogram(found: &Histogram, [low, high, mean]: [f32; 3]) -> Result<(), Finding> {
    near("lower end of the range", found.range[0], low)?;
    near("upper end of the range", found.range[1], high)?;
    let count: u64 = found.bins.iter().sum();
    let sum: f64 = (found.bins.iter().enumerate())
        .map(|(bin, &count)| bin as f64 * count as f64)
        .sum();
    near("mean of the bins", (sum / count as f64) as f32, mean)
}
