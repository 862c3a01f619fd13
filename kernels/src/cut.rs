//! A cut on the device.

use crate::buffer::Buffer;
use crate::layout::{self, RegionCut, RegionMesh};
use crate::mesh_regions::MeshRegions;
use crate::stages::dual::Counted;
use crate::{ErrorEstimate, Level, Mesher, Pyramid};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

/// The leaves of a pyramid (`docs/algorithm.md#4-importance-and-cut`), on the device: one byte per node. The cut keeps the sizes of its
/// meshes, so that for another cut of the same pyramid only the differing regions are meshed.
pub struct Cut {
    /// Id of its pyramid.
    pub(crate) pyramid: u64,
    pub(crate) params: layout::CutParams,
    pub(crate) mesher: Mesher,
    pub(crate) prefix: Level,
    /// For each slot the level of the leaf that represents it, or `INTERNAL`.
    pub(crate) state: Buffer<u8>,
    /// Sums over the leaves of each active region.
    pub(crate) regions: Vec<RegionCut>,
    /// Results of the counting passes, kept for meshing.
    pub(crate) counted: Mutex<Option<(Counted, Vec<RegionMesh>)>>,
    /// Sizes of its meshes, once all of them are known.
    pub(crate) meshes: Mutex<Option<Arc<CutMeshes>>>,
    /// Vertices of marching cubes that could not be patched.
    pub(crate) unpatched_vertices: AtomicU64,
}

/// Sizes of the meshes of a cut.
pub(crate) struct CutMeshes {
    /// Vertices and triangles of each active region.
    pub counts: Vec<RegionMesh>,
    /// The regions in which the surface was made.
    pub regions: MeshRegions,
}

impl Cut {
    /// Leaves of each level, 0 (finest) first.
    pub fn leaves(&self) -> [u64; 6] {
        sum_levels(self.regions.iter().map(|region| &region.leaves))
    }

    /// Number of leaves of this cut's prefix at a level. For the marching-cubes mesher, without those beside missing samples.
    pub fn prefix_leaves(&self, level: Level) -> u64 {
        let from = usize::from(level.get());
        self.regions
            .iter()
            .map(|region| region_prefix_leaves(region, from))
            .sum()
    }

    /// Leaves in one of the pyramid's active regions.
    pub fn region_leaves(&self, region: usize) -> u64 {
        region_prefix_leaves(&self.regions[region], 0)
    }

    /// Level of the prefix, or [`Level::FINEST`] if undecided cubes are not leaves.
    pub fn prefix(&self) -> Level {
        self.prefix
    }

    /// Whether it is a cut of this pyramid.
    pub fn is_of(&self, pyramid: &Pyramid) -> bool {
        self.pyramid == pyramid.id
    }

    /// Leaves above level 0 whose corners all have one sign.
    pub fn lost_cubes(&self) -> u64 {
        self.regions.iter().map(|region| u64::from(region.lost_cubes)).sum()
    }

    /// Estimated distance of its surface from the undecimated one.
    pub fn estimate(&self) -> ErrorEstimate {
        let (mut error2, mut weight, mut worst_leaf) = (0.0, 0u64, 0f32);
        for region in &self.regions {
            error2 += f64::from(region.error2);
            weight += u64::from(region.weight);
            worst_leaf = worst_leaf.max(region.worst);
        }
        let mean2 = if weight == 0 { 0.0 } else { error2 / weight as f64 };
        ErrorEstimate {
            rms: mean2.sqrt() as f32,
            worst_leaf,
        }
    }

    /// Bytes it holds on the device.
    pub fn device_bytes(&self) -> u64 {
        self.state.allocated_bytes()
    }

    /// Whether vertices of the same leaf are equal in both cuts.
    pub(crate) fn has_vertices_of(&self, other: &Self) -> bool {
        let of = |cut: &Self| {
            (
                cut.pyramid,
                cut.params.feature_lo,
                cut.params.feature_span,
                cut.params.cap,
            )
        };
        self.mesher == Mesher::Dual && other.mesher == Mesher::Dual && of(self) == of(other)
    }
}

fn region_prefix_leaves(region: &RegionCut, from: usize) -> u64 {
    let leaves: u64 = region.leaves[from..].iter().map(|&n| u64::from(n)).sum();
    leaves + if from > 0 { u64::from(region.undecided[from]) } else { 0 }
}

/// Leaves of all regions, by level.
pub(crate) fn sum_levels<'a>(regions: impl Iterator<Item = &'a [u32; 6]>) -> [u64; 6] {
    let mut leaves = [0; 6];
    for region in regions {
        for (sum, &n) in leaves.iter_mut().zip(region) {
            *sum += u64::from(n);
        }
    }
    leaves
}
