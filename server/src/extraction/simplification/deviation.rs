//! The measured error of a simplified surface.

use isopeel_kernels::{REGION_CELLS, SurfaceError};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::distance::Triangles;
use super::welded::{Triangle, Welded, world};
use crate::math::DVec3;

/// Distances between a simplified surface and its source, both ways: from the source's vertices to the simplified surface, and
/// from the centres of its triangles to the source.
pub(super) struct Deviation {
    /// For both ways: sum of squared distances, count, maximum distance.
    whole: [(f64, u64, f64); 2],
    /// By region.
    regions: FxHashMap<[u32; 3], [(f64, u64, f64); 2]>,
}

impl Deviation {
    pub(super) fn measure(
        welded: &[Welded],
        source: usize,
        before: &[[u32; 3]],
        after: &[Triangle],
        used: &[bool],
        spacing: [f64; 3],
    ) -> Self {
        let positions: Vec<DVec3> = welded.par_iter().map(|v| world(v, spacing)).collect();
        let after: Vec<[u32; 3]> = after.iter().map(|t| t.corners).collect();
        let centres: Vec<DVec3> = (after.par_iter())
            .map(|t| t.map(|v| positions[v as usize]).iter().sum::<DVec3>() / 3.0)
            .collect();
        // The distance of vertices that were kept is 0.
        let removed: Vec<DVec3> = (0..source).filter(|&v| !used[v]).map(|v| positions[v]).collect();
        let kept = (source - removed.len()) as u64;
        let (there, back) = rayon::join(
            || Triangles::new(&positions, &after).distances(&removed),
            || Triangles::new(&positions, before).distances(&centres),
        );
        let mut deviation = Self {
            whole: [(0.0, kept, 0.0), (0.0, 0, 0.0)],
            regions: FxHashMap::default(),
        };
        for (v, _) in used[..source].iter().enumerate().filter(|(_, used)| **used) {
            deviation.regions.entry(region_at(positions[v], spacing)).or_default()[0].1 += 1;
        }
        for (way, (points, distances)) in [(removed, there), (centres, back)].into_iter().enumerate() {
            for (p, d) in points.into_iter().zip(distances) {
                let region = deviation.regions.entry(region_at(p, spacing)).or_default();
                for sums in [&mut deviation.whole[way], &mut region[way]] {
                    *sums = (sums.0 + d * d, sums.1 + 1, sums.2.max(d));
                }
            }
        }
        deviation
    }

    /// An upper bound of the error against the true surface, of a region or the whole, from the source's own error: by the triangle
    /// inequality distances add up at each point, and so they do in the root mean square.
    pub(super) fn added_to(&self, source: SurfaceError, region: Option<[u32; 3]>) -> SurfaceError {
        let both = match region {
            Some(coords) => self.regions.get(&coords).copied().unwrap_or_default(),
            None => self.whole,
        };
        let mean2 = |(sum, count, _): (f64, u64, f64)| sum / count.max(1) as f64;
        SurfaceError {
            rms: source.rms + ((mean2(both[0]) + mean2(both[1])) / 2.0).sqrt() as f32,
            max: source.max + both[0].2.max(both[1].2) as f32,
        }
    }
}

fn region_at(world: DVec3, spacing: [f64; 3]) -> [u32; 3] {
    [0, 1, 2].map(|axis| (world[axis] / spacing[axis] / f64::from(REGION_CELLS)) as u32)
}
