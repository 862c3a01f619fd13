//! The stated error of a polished surface.

use isopeel_kernels::{REGION_CELLS, SurfaceError};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::distance::Triangles;
use super::weld::{Triangle, Welded, world};
use crate::math::DVec3;

/// How far a polished surface is from the one that it was made from: over the vertices that were left out their distance to
/// it, and over its triangles the distance of their centres to the other.
pub(super) struct Strayed {
    /// Squared distances of both kinds: sum, count, the greatest.
    whole: [(f64, u64, f64); 2],
    /// By region.
    regions: FxHashMap<[u32; 3], [(f64, u64, f64); 2]>,
}

impl Strayed {
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
        // Vertices that stayed are off by nothing.
        let gone: Vec<DVec3> = (0..source).filter(|&v| !used[v]).map(|v| positions[v]).collect();
        let kept = (source - gone.len()) as u64;
        let (there, back) = rayon::join(
            || Triangles::new(&positions, &after).distances(&gone),
            || Triangles::new(&positions, before).distances(&centres),
        );
        let mut strayed = Self {
            whole: [(0.0, kept, 0.0), (0.0, 0, 0.0)],
            regions: FxHashMap::default(),
        };
        for (v, _) in used[..source].iter().enumerate().filter(|(_, used)| **used) {
            strayed.regions.entry(region_at(positions[v], spacing)).or_default()[0].1 += 1;
        }
        for (way, (points, distances)) in [(gone, there), (centres, back)].into_iter().enumerate() {
            for (p, d) in points.into_iter().zip(distances) {
                let region = strayed.regions.entry(region_at(p, spacing)).or_default();
                for sums in [&mut strayed.whole[way], &mut region[way]] {
                    *sums = (sums.0 + d * d, sums.1 + 1, sums.2.max(d));
                }
            }
        }
        strayed
    }

    /// The stated error of the surface before with the way from there, of a region or the whole. A point of the true surface
    /// is no further from the polished one than the one before is from it, and that from the polished one, at each point and so
    /// in the root mean square too: sums bound both.
    pub(super) fn added_to(&self, before: SurfaceError, region: Option<[u32; 3]>) -> SurfaceError {
        let both = match region {
            Some(coords) => self.regions.get(&coords).copied().unwrap_or_default(),
            None => self.whole,
        };
        let mean2 = |(sum, count, _): (f64, u64, f64)| sum / count.max(1) as f64;
        SurfaceError {
            rms: before.rms + ((mean2(both[0]) + mean2(both[1])) / 2.0).sqrt() as f32,
            max: before.max + both[0].2.max(both[1].2) as f32,
        }
    }
}

fn region_at(world: DVec3, spacing: [f64; 3]) -> [u32; 3] {
    [0, 1, 2].map(|axis| (world[axis] / spacing[axis] / f64::from(REGION_CELLS)) as u32)
}
