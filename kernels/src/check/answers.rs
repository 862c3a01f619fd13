//! What the check's steps must find, and how a finding is compared with it.

use super::Finding;
use crate::{Histogram, Surface, Vertex};
use std::collections::HashMap;

/// Values that depend on the compiler's rounding differ by less than this share.
const ROUNDING: f64 = 1e-2;

/// Values that depend on which vertices are merged differ by less than this share: where costs are equal, rounding decides.
const CHOICE: f64 = 1e-1;

/// Isovalue of the surface.
pub(super) const ISOVALUE: f32 = 40.5;

/// Open edges, and parts or handles, by which a decimated surface may differ.
const EDGE_SLACK: u64 = 8;

/// The largest value, also of the upper end of the histogram.
pub(super) const VALUE_END: u32 = 120;

/// Values along the longest axis of the overview, whose blocks have different sizes along the axes.
pub(super) const OVERVIEW_SIDE: u32 = 20;

/// Cubes of an importance up to this are decimated.
pub(super) const BETA: f32 = 0.05;

pub(super) const ACTIVE_BRICKS: u64 = 47;
/// Triangles of the full surface by marching cubes.
pub(super) const FULL_TRIANGLES: u64 = 7240;
pub(super) const BUDGET: u64 = 2000;
pub(super) const FITTED_TRIANGLES: u64 = 1987;
pub(super) const FULL: Known = Known {
    triangles: 7384,
    vertices: 3764,
    open_edges: 100,
    euler: 22,
    volume: -6934.0977,
};
pub(super) const DECIMATED: Known = Known {
    triangles: 3794,
    vertices: 1958,
    open_edges: 100,
    euler: 12,
    volume: -6862.458,
};
pub(super) const TREE_BUDGET: u64 = 1500;
pub(super) const TREE: Known = Known {
    triangles: 1494,
    vertices: 758,
    open_edges: 24,
    euler: 1,
    volume: -6874.155,
};
/// Triangles of the tree's cut with weights of regions.
pub(super) const WEIGHTED_TRIANGLES: u64 = 1213;
/// Regions in which that cut differs from the other one.
pub(super) const WEIGHTED_REGIONS: u64 = 5;
/// Nodes of this cut that move.
pub(super) const TREE_MOVED: u64 = 473;
/// The full surface by marching cubes.
pub(super) const FULL_MARCHED: Known = Known {
    triangles: FULL_TRIANGLES,
    vertices: 3692,
    open_edges: 100,
    euler: 22,
    volume: -6855.2104,
};
/// Triangles, vertices and unpatched vertices of the decimated surface by marching cubes.
pub(super) const MARCHED: [u64; 3] = [3644, 2025, 80];
/// Points, those of merged leaves, and their mean bin.
pub(super) const CUBES_DISTRIBUTION: [f32; 3] = [3526.0, 1996.0, 15.8474];
pub(super) const TREE_DISTRIBUTION: [f32; 3] = [3518.0, 3210.0, 14.9389];
/// Triangles at the lower end, at most at the upper end, and the error of half of them.
pub(super) const CUBES_CURVE: [f32; 3] = [7209.0, 16.0, 0.16199];
pub(super) const TREE_CURVE: [f32; 3] = [6960.0, 120.0, 0.031777];
/// Regions in which the cuts without and with decimation differ.
pub(super) const DIFFERING: [bool; 6] = [true; 6];
pub(super) const MIXED_TRIANGLES: u64 = 7326;
/// Cubes of a local variance up to this share of the largest one are decimated.
pub(super) const VARIANCE_BETA: f32 = 0.03;
pub(super) const VARIANCE_LEAVES: u64 = 2605;
/// Centre of the region of interest, in cells.
pub(super) const INTEREST: [f32; 3] = [88.0, 10.0, 21.0];
/// More than the area of the ball, less than that of the ellipsoid.
pub(super) const BALL_AREA: f32 = 200.0;
/// Cubes of an importance up to this are decimated: all but those in the region of interest.
pub(super) const WIDE_BETA: f32 = 0.9;
pub(super) const ERROR: [f32; 2] = [0.09084828, 0.7650088];
pub(super) const WIDE_ERROR: [f32; 2] = [9.7921505, 75.084076];
pub(super) const TREE_ERROR: f32 = 0.11141917;
pub(super) const PROBED: [f32; 2] = [0.066604614, 2153.2703];
pub(super) const VERTEX_DISTANCE: f32 = 0.7663465;
pub(super) const CORNER_DISTANCES: [f32; 2] = [92.87626, 20.22375];
/// Lower and upper end, samples, and mean number of a bin.
pub(super) const GRADIENT: [f32; 4] = [0.0, 45.0, 127_296.0, 11.623735];
pub(super) const VARIANCE: [f32; 4] = [0.0, 924.321, 110_976.0, 3.6091046];
pub(super) const UNEVEN_GRADIENT: [f32; 4] = [0.0, 40.693764, 127_296.0, 10.861802];

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
    /// Checks a surface that has the same counts on every device.
    pub fn check(&self, surface: &Surface) -> Result<(), Finding> {
        self.check_within(surface, 0, 0, ROUNDING)
    }

    /// Checks a surface whose counts depend on rounding in comparisons.
    pub fn check_nearly(&self, surface: &Surface) -> Result<(), Finding> {
        self.check_within(surface, (self.triangles as f64 * CHOICE) as u64, EDGE_SLACK, CHOICE)
    }

    /// `slack`, `edge_slack`: of counts, and of open edges and the Euler characteristic; `share`: of the volume.
    fn check_within(&self, surface: &Surface, slack: u64, edge_slack: u64, share: f64) -> Result<(), Finding> {
        let (found, stated) = (Self::of(surface), &surface.statistics);
        exact("number of triangles", stated.triangles, found.triangles)?;
        exact("number of vertices", stated.vertices, found.vertices)?;
        let count =
            |what, found: u64, expected: u64, slack| within(what, found.cast_signed(), expected.cast_signed(), slack);
        count("number of triangles", found.triangles, self.triangles, slack)?;
        count("number of vertices", found.vertices, self.vertices, slack)?;
        count("number of open edges", found.open_edges, self.open_edges, edge_slack)?;
        within("Euler characteristic", found.euler, self.euler, edge_slack)?;
        within_share("volume inside", found.volume as f32, self.volume as f32, share)
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

fn within(what: &'static str, found: i64, expected: i64, slack: u64) -> Result<(), Finding> {
    if found.abs_diff(expected) <= slack {
        return Ok(());
    }
    exact(what, found, expected)
}

/// As [`exact`], of a count that depends on rounding in comparisons.
pub(super) fn nearly(what: &'static str, found: u64, expected: u64) -> Result<(), Finding> {
    let slack = (expected as f64 * CHOICE) as u64;
    within(what, found.cast_signed(), expected.cast_signed(), slack)
}

/// Compares a value that depends on rounding.
pub(super) fn near(what: &'static str, found: f32, expected: f32) -> Result<(), Finding> {
    within_share(what, found, expected, ROUNDING)
}

/// Compares a value that depends on which vertices are merged.
pub(super) fn roughly(what: &'static str, found: f32, expected: f32) -> Result<(), Finding> {
    within_share(what, found, expected, CHOICE)
}

fn within_share(what: &'static str, found: f32, expected: f32, share: f64) -> Result<(), Finding> {
    if (f64::from(found) - f64::from(expected)).abs() <= share * f64::from(expected).abs() {
        return Ok(());
    }
    Err(Finding::Differs {
        what,
        found: found.to_string(),
        expected: expected.to_string(),
    })
}

/// Compares a histogram's range, its samples and the mean number of their bins.
pub(super) fn near_histogram(found: &Histogram, [low, high, samples, mean]: [f32; 4]) -> Result<(), Finding> {
    near("lower end of the range", found.range[0], low)?;
    near("upper end of the range", found.range[1], high)?;
    let count: u64 = found.bins.iter().sum();
    exact("number of samples in bins", count as f32, samples)?;
    let sum: f64 = (found.bins.iter().enumerate())
        .map(|(bin, &count)| bin as f64 * count as f64)
        .sum();
    near("mean of the bins", (sum / count as f64) as f32, mean)
}
